"""What Kubernetes or ROS would refuse is told before anything is sent, at its place."""

from __future__ import annotations

import pytest

from .shapes import GOLDEN, find, problems, release

#: (what is told, where, the job's `with`)
WRONG = [
    ("conflict", "ros_version", "{ros_version: ros2}"),
    ("ros1", "middleware", "{middleware: cyclonedds}"),
    (
        "two-masters",
        "ros_master_uri",
        "{ros_master_uri: 'http://a:11311', deploy_ros_master: true}",
    ),
    ("name-taken", "deployment_name", "{deployment_name: ros-master, application_image: a}"),
    ("name-taken", "nodes.b/c", "{image: a, nodes: {b_c: {args: x}, b/c: {args: x}}}"),
    ("name-taken", "nodes.ros_master", "{image: a, nodes: {ros_master: {args: x}}}"),
    (
        "name-taken",
        "nodes.app",
        "{application_image: a, image: a, deployment_name: app, nodes: {app: {}}}",
    ),
    ("name-taken", "nodes.c", "{image: a, nodes: {b: {args: x}, c: {args: x, name: b}}}"),
    (
        "name-taken",
        "persistent_storage.volumes.1.name",
        "{persistent_storage: {volumes: [{name: v}, {name: v}]}}",
    ),
    ("conflict", "readiness.file", "{readiness: {command: a, file: /b}}"),
    ("not-measured", "expect./a.gap", "{image: a, nodes: {b: {}}, expect: {/a: {gap: 1s}}}"),
    ("not-measured", "update", "{image: a, nodes: {b: {args: x}}, update: {when: idle}}"),
    (
        "no-graph",
        "expect./a.else",
        "{image: a, ros: '2', network: {mode: zenoh}, rmw_layer: false, nodes: {b: {args: x}},"
        " expect: {/a: {rate: 1, else: rollback}}}",
    ),
    (
        "incomplete",
        "rollback_on.within",
        "{image: a, nodes: {b: {args: x}}, expect: {/a: {rate: 1}}, rollback_on: {within: 5s}}",
    ),
    (
        "liveness",
        "nodes.b.liveness",
        "{image: a, nodes: {b: {args: x, liveness: {stuck: 30s}}}}",
    ),
    (
        "liveness",
        "nodes.b.liveness",
        "{image: a, ros: '2', rmw_layer: false, nodes: {b: {args: x, liveness: {stuck: 30s}}}}",
    ),
    (
        "incomplete",
        "nodes.b.liveness",
        "{image: a, ros: '2', nodes: {b: {args: x, liveness: {}}}}",
    ),
    (
        "rates",
        "nodes.b.readiness.rates",
        "{image: a, nodes: {b: {args: x, readiness: {rates: {/c: 8..}}}}}",
    ),
    (
        "rates",
        "nodes.b.readiness.rates",
        "{image: a, ros: '2', rmw_layer: false,"
        " nodes: {b: {args: x, readiness: {rates: {/c: 8}}}}}",
    ),
    (
        "conflict",
        "nodes.b.readiness.rates",
        "{image: a, ros: '2', nodes: {b: {args: x, readiness: {port: 1, rates: {/c: 8}}}}}",
    ),
    (
        "no-application",
        "readiness.rates",
        "{application_image: a, ros: '2', readiness: {rates: {/c: 8}}}",
    ),
    ("bad-command", "readiness.command", '{readiness: {command: "a \'b"}}'),
    ("bad-command", "readiness.command", "{readiness: {command: ''}}"),
    (
        "bad-update",
        "rolling_update.max_surge",
        "{rolling_update: {strategy: Recreate, max_surge: 1}}",
    ),
    ("bad-update", "rolling_update", "{rolling_update: {max_surge: 0, max_unavailable: 0}}"),
    ("bad-update", "rolling_update", "{rolling_update: {max_surge: 0%}}"),
    (
        "hand-over",
        "nodes.b.update.warm",
        "{image: a, ros: '2', nodes: {b: {args: x, devices: [/dev/b], update: {warm: [c]}}}}",
    ),
    (
        "fixed-field",
        "additional_k8s_params.application.metadata.name",
        "{additional_k8s_params: {application: {metadata: {name: x}}}}",
    ),
    (
        "fixed-field",
        "additional_k8s_params.ros_master.spec.selector",
        "{additional_k8s_params: {ros_master: {spec: {selector: {}}}}}",
    ),
    ("bad-ros-name", "parameters.a-b", "{image: a, nodes: {b: {}}, parameters: {a-b: {c: 1}}}"),
    (
        "bad-parameter-file",
        "parameter_files.1",
        "{image: a, nodes: {b: {}}, parameter_files: [a.yaml, {namespace: n}]}",
    ),
    (
        "no-substitution",
        "parameter_files",
        "{image: a, nodes: {b: {}}, parameter_files: [{image_file: $(find a)/b}]}",
    ),
    (
        "unknown-substitution",
        "parameters",
        "{image: a, nodes: {b: {}}, parameters: {a: $(eval 1)}, substitution_args: true}",
    ),
    (
        "name-taken",
        "nodes.rigel_k8s_application_global_parameters",
        "{image: a, nodes: {rigel_k8s_application_global_parameters: {}}, parameters: {a: 1}}",
    ),
    ("no-application", "results", "{image: a, nodes: {b: {}}, results: {source_path: /r}}"),
    ("pod-node", "nodes.b.pod", "{image: a, nodes: {b: {args: x, pod: p}}}"),
    *(
        (kind, f"nodes.c.{path}", f"{{image: a, ros: '2', network: peers, nodes: {{{nodes}}}}}")
        for kind, path, nodes in (
            ("pod-node", "anonymous", "c: {args: x, pod: p, anonymous: true}"),
            ("pod-node", "replicas", "c: {args: x, pod: p, replicas: 1}"),
            (
                "pod-node",
                "volumes.0",
                "c: {args: x, pod: p, volumes: [{memory: 1Mi, mount_path: /dev/shm/}]}",
            ),
            (
                "pod-node",
                "placement.apart_from.0",
                "b: {args: x, pod: p}, c: {args: x, pod: p, placement: {apart_from: [b]}}",
            ),
            (
                "pod-conflict",
                "host_network",
                "b: {args: x, pod: p}, c: {args: x, pod: p, host_network: true}",
            ),
            (
                "pod-conflict",
                "update",
                "b: {args: x, pod: p}, c: {args: x, pod: p, update: {strategy: Recreate}}",
            ),
            (
                "pod-conflict",
                "ports",
                "b: {args: x, pod: p, ports: [1]}, c: {args: x, pod: p, ports: [1]}",
            ),
            ("name-taken", "pod", "c: {args: x, pod: b-peer}, b: {args: x}"),
            (
                "many-participants",
                "pod",
                ", ".join(f"{name}: {{args: x, pod: p}}" for name in ("a", "b", "d", "e", "c")),
            ),
            (
                "hand-over",
                "update.strategy",
                "c: {args: x, pod: p, update: {strategy: HandOver}},"
                " b: {args: x, pod: p, devices: [/dev/b]}",
            ),
        )
    ),
    ("name-taken", "nodes.p", "{image: a, ros: '2', nodes: {p: {args: x, pod: p}}}"),
    (
        "pod-conflict",
        "nodes.c.env",
        "{image: a, ros: '2', network: none, nodes: {b: {args: x, pod: p},"
        " c: {args: x, pod: p, env: {ROS_DOMAIN_ID: 4}}}}",
    ),
]

#: The same for one node: its options follow `n:`.
WRONG_NODES = [
    ("bad-ros-name", "", "my-node", "{}"),
    ("conflict", "name", "n", "{name: x, anonymous: true}"),
    ("duplicate-node", "replicas", "n", "{replicas: 2}"),
    ("incomplete", "package", "n", "{package: a}"),
    ("incomplete", "executable", "n", "{executable: a}"),
    ("conflict", "args", "n", "{command: a, args: b}"),
    ("conflict", "launch", "n", "{args: b, launch: {file: a}}"),
    ("conflict", "package", "n", "{command: b, package: a, executable: b}"),
    ("bad-command", "args", "n", '{args: "a \'b"}'),
    ("bad-command", "args", "n", "{args: []}"),
    ("bad-command", "args", "n", f"{{args: {'a' * (2**17 + 1)}}}"),
    ("not-appendable", "parameters", "n", "{parameters: {a: 1}}"),
    ("not-appendable", "remappings", "n", "{remappings: {a: b}}"),
    ("not-appendable", "parameter_files", "n", "{parameter_files: [a.yaml]}"),
    ("not-appendable", "remappings", "n", "{args: [bash, -c, x], remappings: {a: b}}"),
    ("not-appendable", "parameters", "n", "{launch: {file: x}, parameters: {a: 1}}"),
    ("not-appendable", "remappings", "n", "{launch: {file: x}, remappings: {a: b}}"),
    ("not-appendable", "parameter_files", "n", "{args: x, anonymous: true, parameter_files: [a]}"),
    ("bad-ros-name", "parameters.a-b", "n", "{args: x, parameters: {a-b: 1}}"),
    (
        "not-appendable",
        "parameter_commands",
        "n",
        "{args: x, anonymous: true, parameter_commands: {a: b}}",
    ),
    ("not-appendable", "parameter_commands", "n", "{parameter_commands: {a: b}}"),
    ("bad-ros-name", "parameters./", "n", "{args: x, parameters: {/: 1}}"),
    ("bad-parameter-file", "parameter_files.0", "n", "{args: x, parameter_files: ['']}"),
    ("bad-ros-name", "parameter_commands.a-b", "n", "{args: x, parameter_commands: {a-b: b}}"),
    ("bad-command", "parameter_commands.a", "n", "{args: x, parameter_commands: {a: ''}}"),
    (
        "bad-parameter-file",
        "parameter_files.0",
        "n",
        "{args: x, parameter_files: [{file: a, image_file: b}]}",
    ),
    (
        "no-substitution",
        "parameter_commands",
        "n",
        "{args: x, parameter_commands: {a: cat $(find p)/b}}",
    ),
    ("unknown-substitution", "args", "n", "{args: x $(arg y), substitution_args: true}"),
    ("unknown-substitution", "env", "n", "{env: {A: $(dirname /b)}, substitution_args: true}"),
    (
        "unknown-substitution",
        "components",
        "n",
        "{components: {c: {plugin: a/B, parameters: {d: $(anon e)}}}, substitution_args: true}",
    ),
    (
        "unknown-substitution",
        "parameter_files",
        "n",
        "{args: x, parameter_files: [{image_file: $(find a b)}], substitution_args: true}",
    ),
    ("unknown-volume", "volumes.0", "n", "{volumes: [data]}"),
    ("bad-volume", "volumes.0", "n", "{volumes: [{mount_path: /a}]}"),
    ("bad-volume", "volumes.0", "n", "{volumes: [{secret: a, config_map: b, mount_path: /a}]}"),
    ("bad-volume", "volumes.0", "n", "{volumes: [{secret: a}]}"),
    ("bad-volume", "volumes.0.type", "n", "{volumes: [{secret: a, mount_path: /a, type: File}]}"),
    ("bad-device", "devices.0", "n", "{devices: [{count: 1}]}"),
    ("bad-device", "devices.0", "n", "{devices: [{path: /dev/a, resource: b}]}"),
    ("bad-quantity", "volumes.0.memory", "n", "{volumes: [{memory: 64, mount_path: /a}]}"),
    ("bad-quantity", "resources.limits.memory", "n", "{resources: {limits: {memory: 64m}}}"),
    (
        "bad-quantity",
        "resources.requests.memory",
        "n",
        "{resources: {requests: {memory: 64}, limits: {memory: 1Mi}}}",
    ),
    (
        "bad-quantity",
        "resources.limits.memory",
        "n",
        "{resources: {requests: {memory: 64Mi}, limits: {memory: 1023Ki}}}",
    ),
    (
        "conflict",
        "resources.requests.cpu",
        "n",
        "{resources: {requests: {cpu: 2, memory: 0}, limits: {cpu: 1999m, memory: 1Mi}}}",
    ),
    ("unknown-node", "placement.apart_from.0", "n", "{placement: {apart_from: [other]}}"),
    ("unknown-node", "placement.apart_from.0", "n", "{placement: {apart_from: [n]}}"),
    ("fixed-field", "patch.metadata.namespace", "n", "{patch: {metadata: {namespace: a}}}"),
    (
        "wrong-type",
        "patch.spec.template.spec.containers.0.ports",
        "n",
        "{patch: {spec: {template: {spec: {containers: [{name: ros-node, ports: -1}]}}}}}",
    ),
    ("bad-update", "update.max_surge", "n", "{update: {strategy: recreate, max_surge: 1}}"),
    ("conflict", "readiness.file", "n", "{readiness: {command: a, file: /b}}"),
    ("components", "components", "n", "{launch: {file: a}, components: {c: {plugin: a/B}}}"),
    ("components", "components", "n", "{anonymous: true, components: {c: {plugin: a/B}}}"),
    ("components", "components", "n", "{args: [bash, -c, x], components: {c: {plugin: a/B}}}"),
    ("components", "components", "n", "{ros: none, components: {c: {plugin: a/B}}}"),
    ("duplicate-node", "replicas", "n", "{replicas: 2, components: {c: {plugin: a/B}}}"),
    ("name-taken", "components.n", "n", "{components: {n: {plugin: a/B}}}"),
    (
        "name-taken",
        "components.c",
        "n",
        "{components: {b: {plugin: a/B, name: c}, c: {plugin: a/B}}}",
    ),
    ("bad-ros-name", "components.b-c", "n", "{components: {b-c: {plugin: a/B}}}"),
    ("not-ros1", "components.c.package", "n", "{components: {c: {package: a, plugin: a/B}}}"),
    (
        "bad-parameter",
        "components.c.parameters.a",
        "n",
        "{components: {c: {plugin: a/B, parameters: {a: null}}}}",
    ),
]

WARNINGS = [
    ("incomplete", "substitution_args", "{image: a, nodes: {b: {}}, substitution_args: true}"),
    (
        "no-substitution",
        "nodes.b.components",
        "{image: a, nodes: {b: {components: {c: {plugin: a/B, parameters: {d: $(env E)}}}}}}",
    ),
    ("no-substitution", "nodes.b.args", "{image: a, nodes: {b: {args: x $(find p)/y}}}"),
    (
        "no-substitution",
        "nodes.b.parameters",
        "{image: a, nodes: {b: {args: x, parameters: {p: $(env E)}}}}",
    ),
    ("no-shell", "nodes.b.args", "{image: a, nodes: {b: {args: source /x && rosrun a b}}}"),
    ("no-shell", "nodes.b.args", "{image: a, nodes: {b: {args: rosrun a b &}}}"),
    (
        "no-shell",
        "nodes.b.args",
        "{image: a, nodes: {b: {package: p, executable: e, args: '> /log'}}}",
    ),
    ("no-application", "readiness", "{image: a, nodes: {b: {}}, readiness: none}"),
    (
        "no-application",
        "rolling_update",
        "{image: a, nodes: {b: {}}, rolling_update: {strategy: Recreate}}",
    ),
    ("no-application", "distributed", "{image: a, nodes: {b: {}}, distributed: {enabled: true}}"),
    (
        "no-application",
        "additional_k8s_params.application",
        "{image: a, nodes: {b: {}}, additional_k8s_params: {application: {spec: {replicas: 2}}}}",
    ),
    ("surge", "rolling_update", "{application_image: a, rolling_update: {strategy: Rolling}}"),
    ("surge", "nodes.n.update", "{image: a, nodes: {n: {update: {max_unavailable: 1}}}}"),
    ("no-master", "deploy_ros_master", "{image: a, deploy_ros_master: false, nodes: {n: {}}}"),
    (
        "device-access",
        "nodes.n.devices.0",
        "{image: a, nodes: {n: {devices: [/dev/a], placement: {node: r}}}}",
    ),
    (
        "one-pod",
        "nodes.b.pod",
        "{image: a, ros: '2', network: peers,"
        " nodes: {b: {args: x, pod: p}, c: {args: x, pod: p, update: {strategy: HandOver}}}}",
    ),
    (
        "no-memory",
        "nodes.b.pod",
        "{image: a, ros: '2', network: host, nodes: {b: {args: x, pod: p}}}",
    ),
]


def told(text: str, severity: str, distro: str = "noetic") -> set[tuple[str, str]]:
    """Return (kind, place) of all problems of a severity."""
    found = [p for p in problems(text, distro) if p.severity == severity]
    for problem in found:
        assert problem.message
        assert not problem.message.endswith(".")
    return {(p.kind, ".".join(map(str, p.path))) for p in found}


@pytest.mark.parametrize(("kind", "place", "text"), WRONG)
def test_contradictions_are_told_at_their_place(kind: str, place: str, text: str) -> None:
    """One mistake is one problem, of its kind, at its place."""
    assert told(text, "error") == {(kind, place)}


@pytest.mark.parametrize(("kind", "place", "key", "text"), WRONG_NODES)
def test_a_nodes_mistakes_are_told(kind: str, place: str, key: str, text: str) -> None:
    """One mistake of a node is one problem below its key."""
    where = f"nodes.{key}" + (f".{place}" if place else "")
    assert told(f"{{image: a, nodes: {{{key}: {text}}}}}", "error") == {(kind, where)}


@pytest.mark.parametrize(("kind", "place", "text"), WARNINGS)
def test_what_works_otherwise_than_it_looks_is_a_warning(kind: str, place: str, text: str) -> None:
    """A warning stops nothing."""
    assert told(text, "warning") == {(kind, place)}
    assert told(text, "error") == set()


@pytest.mark.parametrize(
    "text",
    [
        "{image: a, nodes: {b: {args: [bash, -c, 'source /x && find $(find p)']}}}",
        "{image: a, nodes: {b: {command: [sh, -c], args: ['a && b']}}}",
        "{image: a, nodes: {b: {}}, readiness: {timeout_seconds: 600}}",
        "{application_image: a, image: a, nodes: {b: {}}, readiness: none}",
    ],
)
def test_what_has_an_effect_is_not_warned_of(text: str) -> None:
    """A shell reads its own lines; the time of `readiness` is that of the roll-out."""
    assert told(text, "warning") == set()


def test_requests_up_to_the_limits_are_right() -> None:
    """0 requests nothing, and one number may be written in two ways."""
    resources = (
        "{requests: {memory: 0, cpu: 0.5, a/b: 1}, limits: {memory: 1Mi, cpu: 500m, a/b: 1}}"
    )
    assert told(f"{{image: a, nodes: {{n: {{resources: {resources}}}}}}}", "error") == set()


def test_a_node_without_an_image_is_told() -> None:
    """The image is the node's own or that of all nodes."""
    assert told("{nodes: {n: {}}}", "error") == {("missing-image", "nodes.n")}
    assert told("{nodes: {n: {image: a}}}", "error") == set()


NET = "network: host"
#: (what is told, where, the job's `with`) for a distribution of ROS 2.
WRONG2 = [
    ("no-master-in-ros2", "deploy_ros_master", "{application_image: a, deploy_ros_master: true}"),
    (
        "no-master-in-ros2",
        "ros_master_uri",
        "{application_image: a, ros_master_uri: 'http://a:11311'}",
    ),
    ("no-master-in-ros2", "ros_master_image", "{application_image: a, ros_master_image: b}"),
    ("not-ros", "nodes.n.parameters", "{image: a, ros: none, nodes: {n: {parameters: {a: 1}}}}"),
    ("not-ros", "nodes.n.package", "{image: a, ros: none, nodes: {n: {package: p}}}"),
    (
        "not-appendable",
        "nodes.n.parameters",
        "{image: a, nodes: {n: {args: ros2 topic list, parameters: {a: 1}}}}",
    ),
    (
        "not-appendable",
        "nodes.n.parameters",
        "{image: a, nodes: {n: {args: ros2 topic list > /f, parameters: {a: 1}}}}",
    ),
    (
        "not-appendable",
        "nodes.n.parameter_files",
        "{image: a, nodes: {n: {launch: {file: /a.py}, parameter_files: [a.yaml]}}}",
    ),
    (
        "sidecar",
        "nodes.n.patch.spec.template.spec.containers",
        "{image: a, nodes: {n: {args: x, patch:"
        " {spec: {template: {spec: {containers: [{name: tool, image: b}]}}}}}}}",
    ),
    (
        "sidecar",
        "additional_k8s_params.application.spec.template.spec.containers",
        "{application_image: a, additional_k8s_params: {application:"
        " {spec: {template: {spec: {containers: [{name: tool, image: b}]}}}}}}",
    ),
    ("duplicate-node", "nodes.n.replicas", "{image: a, nodes: {n: {args: x, replicas: 2}}}"),
    ("incomplete", "nodes.n.lifecycle", "{image: a, nodes: {n: {args: x, lifecycle: {}}}}"),
    (
        "components",
        "nodes.n.components",
        "{image: a, nodes: {n: {update: {strategy: Rolling},"
        " components: {c: {package: a, plugin: b}}}}}",
    ),
    (
        "incomplete",
        "nodes.n.components.c",
        "{image: a, nodes: {n: {components: {c: {plugin: a}}}}}",
    ),
    (
        "bad-parameter",
        "nodes.n.components.c.parameters.a",
        "{image: a, nodes: {n: {components:"
        " {c: {package: a, plugin: b, parameters: {a: [1, x]}}}}}}",
    ),
    (
        "bad-parameter",
        "nodes.n.components.c.parameters.a",
        "{image: a, nodes: {n: {components:"
        " {c: {package: a, plugin: b, parameters: {a: [true, 1.5]}}}}}}",
    ),
    (
        "bad-parameter",
        "nodes.n.parameters.a",
        "{image: a, nodes: {n: {args: x, parameters: {a: {b: [1, x]}}}}}",
    ),
    (
        "bad-parameter",
        "nodes.n.parameters.a",
        "{image: a, nodes: {n: {args: x, parameters: {a: [[1], [2]]}}}}",
    ),
    (
        "name-taken",
        "nodes.b",
        "{image: a, nodes: {a: {components: {c: {package: a, plugin: b}}}, b: {args: x, name: c}}}",
    ),
    (
        "name-taken",
        "nodes.n-peer",
        "{image: a, network: peers, nodes: {n: {args: x}, n-peer: {args: x, name: p}}}",
    ),
    (
        "name-taken",
        "nodes.d-zenoh",
        "{image: a, deployment_name: d, network: zenoh, nodes: {d-zenoh: {args: x, name: d}}}",
    ),
    (
        "reserved-label",
        "nodes.n.labels.rigel-k8s/release",
        "{image: a, nodes: {n: {args: x, labels: {rigel-k8s/release: x}}}}",
    ),
]


@pytest.mark.parametrize(("kind", "path", "text"), WRONG2, ids=[f"{w[0]}-{w[1]}" for w in WRONG2])
def test_what_ros2_or_dds_would_not_do_is_told(kind: str, path: str, text: str) -> None:
    """Each at its place."""
    assert (kind, path) in told(text, "error", "jazzy")


@pytest.mark.parametrize("value", ["[1, 2.5]", "['$(env A)', 1]", "[a, '$(env A)']"])
def test_lists_that_ros2_accepts(value: str) -> None:
    """Only a container knows what becomes of a text with an expression."""
    node = f"{{args: x, substitution_args: true, parameters: {{a: {value}}}}}"
    assert told(f"{{image: a, {NET}, nodes: {{n: {node}}}}}", "error", "jazzy") == set()


def test_ros2_needs_no_master() -> None:
    """A Rigelfile that asks for none has none."""
    assert told(f"{{application_image: a, {NET}}}", "error", "jazzy") == set()


def test_a_sidecar_may_be_allowed() -> None:
    """Who knows that it has nothing to do with DDS says so; ROS 1 shares nothing that clashes."""
    patch = "{spec: {template: {spec: {containers: [{name: tool, image: b}]}}}}"
    text = f"image: a, nodes: {{n: {{args: x, patch: {patch}}}}}"
    assert told(f"{{{text}, {NET}, allow_sidecars: true}}", "error", "jazzy") == set()
    assert told(f"{{{text}}}", "error", "noetic") == set()


def test_surge_of_a_named_ros2_node_is_warned_of() -> None:
    """Two nodes of one name answer each other's services for a while."""
    text = f"{{image: a, {NET}, nodes: {{n: {{args: x, update: {{max_surge: 1}}}}}}}}"
    assert ("surge", "nodes.n.update") in told(text, "warning", "jazzy")


#: Why a node cannot have transitions: its options, and what is said.
NO_TRANSITIONS = {
    "anonymous": "args: x, anonymous: true",
    "a launch file": "launch: {file: a.launch.py}",
    "component container": "components: {c: {package: a, plugin: b}}",
    "rolling update": "args: x, update: {strategy: Rolling}",
    "the image's CMD": "labels: {}",
    "bash does not pass": "args: [bash, -c, x]",
    "only ROS 2": "args: x, ros: none",
}


@pytest.mark.parametrize("reason", NO_TRANSITIONS)
def test_transitions_that_cannot_be_made_are_refused(reason: str) -> None:
    """At the option that asks for them; HandOver is refused at its own place."""
    node = f"{NO_TRANSITIONS[reason]}, lifecycle: {{start: [configure]}}"
    text = f"{{image: a, {NET}, nodes: {{n: {{{node}}}}}}}"
    found = [one for one in problems(text, "jazzy") if one.severity == "error"]
    assert [one.path for one in found] == [("nodes", "n", "lifecycle")]
    assert reason in found[0].message


@pytest.mark.parametrize(
    "env", ["{ROS_MASTER_URI: http://a:1}", "[{name: ROS_MASTER_URI, value: http://a:1}]"]
)
def test_a_node_with_a_master_of_its_own_is_not_handed_over(env: str) -> None:
    """The gate cannot manage it, in whichever form `env` is written."""
    text = f"{{image: a, nodes: {{n: {{args: x, env: {env}, update: {{strategy: HandOver}}}}}}}}"
    found = [one for one in problems(text) if one.kind == "hand-over"]
    assert [one.path for one in found] == [("nodes", "n", "update", "strategy")]
    assert "it has a ROS_MASTER_URI of its own" in found[0].message


def test_a_node_of_ros1_has_no_lifecycle() -> None:
    """It is told so where it asks for one."""
    text = "{image: a, nodes: {n: {args: x, lifecycle: {stop: [shutdown]}}}}"
    assert told(text, "error") == {("lifecycle", "nodes.n.lifecycle")}


LAN = "network: {mode: macvlan, interface: eth0, subnet: 10.20.0.0/24}"
STATIC = LAN.replace("}", ", ipam: static}")
#: Why a node of ROS 2 cannot be handed over: what is said of it, and of its network.
NO_HAND_OVER = {
    "it runs the image's CMD": ("{}", LAN),
    "the image's ENTRYPOINT: set `command`": ("args: [--fast]", LAN),
    "its patch sets what its container runs": (
        "args: x, patch: {spec: {template: {spec: {containers: [{name: n, args: [y]}]}}}}",
        LAN,
    ),
    "`rmw_layer` is false": ("args: x, rmw_layer: false", LAN),
    "the device /dev/a": ("args: x, devices: [/dev/a]", LAN),
    "it has a port of its machine": ("args: x, ports: [80]", "network: host"),
    "a port of its machine": ("args: x, ports: [80], host_network: true", "network: none"),
    "it has a readiness check of its own": ("args: x, readiness: none", LAN),
    "two pods would have one address": ("args: x", STATIC),
    "it has no ROS": ("args: x, ros: none", LAN),
    "differs in each pod": ("args: x, anonymous: true", LAN),
    "it is privileged": ("args: x, security_context: {privileged: true}", LAN),
    "port of its machine": (
        "args: x, patch: {spec: {template: {spec: {containers:"
        " [{name: n, ports: [{hostPort: 80}]}]}}}}",
        LAN,
    ),
    "it mounts a claim that may be exclusive": (
        "args: x, patch: {spec: {template: {spec: {volumes:"
        " [{name: v, persistentVolumeClaim: {claimName: c}}]}}}}",
        LAN,
    ),
    "its volume a is ReadWriteOnce": (
        "args: x, volumes: [a]",
        f"{LAN}, persistent_storage: {{volumes: [{{name: a}}]}}",
    ),
}


@pytest.mark.parametrize("reason", NO_HAND_OVER)
def test_a_ros2_node_that_cannot_be_handed_over_is_refused(reason: str) -> None:
    """At the word that asks for it, and the message says why."""
    node, network = NO_HAND_OVER[reason]
    node = "" if node == "{}" else f"{node}, "
    text = f"{{image: a, {network}, nodes: {{n: {{{node}update: {{strategy: HandOver}}}}}}}}"
    found = [one for one in problems(text, "jazzy") if one.kind == "hand-over"]
    assert [one.path for one in found] == [("nodes", "n", "update", "strategy")]
    assert reason in found[0].message


HAND_OVER = (
    ("launch: {file: a.launch.py}", LAN),
    ("args: [bash, -c, x]", LAN),
    ("command: x", LAN),
    ("package: a, executable: b", LAN),
    ("args: x, lifecycle: {start: [configure]}", LAN),
    ("args: x, readiness: {rates: {/c: 8..}, timeout_seconds: 60}", LAN),
    ("components: {c: {package: a, plugin: b}}", LAN),
    ("args: x, ports: [80]", LAN),
    ("args: x, host_network: true", "network: none"),
    *(("args: x", f"network: {mode}") for mode in ("host", "peers", "discovery-server")),
)
ZENOH = ("network: zenoh", "middleware: zenoh, network: none")


@pytest.mark.parametrize(("node", "network"), HAND_OVER)
@pytest.mark.parametrize("update", ["", ", update: {strategy: HandOver}"])
def test_any_other_ros2_node_hands_over(node: str, network: str, update: str) -> None:
    """With every program, in every mode of DDS; without a request, too."""
    text = f"{{image: a, {network}, nodes: {{n: {{{node}{update}}}}}}}"
    assert [one for one in problems(text, "jazzy") if one.severity == "error"] == []
    made = find(release(text, distro="jazzy"), "Deployment", "n")
    assert made["metadata"]["annotations"]["rigel-k8s/update"] == "HandOver"
    assert made["spec"]["strategy"]["type"] == "RollingUpdate"


@pytest.mark.parametrize("network", ZENOH)
def test_over_zenoh_nodes_hand_over_on_request(network: str) -> None:
    """It was not run there; one warning says so, until an update is chosen."""

    def way(update: str, warned: set[tuple[str, str]]) -> str:
        text = f"{{image: a, {network}, nodes: {{n: {{args: x{update}}}, o: {{args: x{update}}}}}}}"
        assert told(text, "error", "jazzy") == set()
        assert {one for one in told(text, "warning", "jazzy") if one[0] == "hand-over"} == warned
        made = find(release(text, distro="jazzy"), "Deployment", "o")
        return str(made["metadata"]["annotations"]["rigel-k8s/update"]).partition(":")[0]

    assert way("", {("hand-over", "nodes.n")}) == "Recreate"
    assert way(", update: {strategy: HandOver}", set()) == "HandOver"
    assert way(", update: {strategy: Recreate}", set()) == "Recreate"


def test_what_is_for_another_kind_of_update_is_refused() -> None:
    """At its own place."""

    def node(update: str, distro: str = "jazzy") -> set[tuple[str, str]]:
        text = f"{{image: a, {LAN}, nodes: {{n: {{args: x, update: {{{update}}}}}}}}}"
        return told(text, "error", distro)

    assert node("drain: 1m, warm: [scan]") == set()
    assert node("strategy: HandOver, drain: 1m, warm: [/scan]") == set()
    assert node("strategy: Recreate, drain: 1m") == {("bad-update", "nodes.n.update.drain")}
    assert node("strategy: Rolling, warm: [a]") == {("bad-update", "nodes.n.update.warm")}
    assert ("bad-update", "nodes.n.update.drain") in node("drain: 1m", "noetic")


def test_without_the_library_ros2_nodes_are_deployed_as_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An installation that was built without a compiler says so once, and works."""
    text = "{image: a, network: peers, nodes: {n: {args: x}, m: {args: x}}}"
    assert told(text, "warning", "jazzy") == set()
    monkeypatch.setattr("rigel_k8s.app.checks.application.libraries", dict)
    assert told(text, "warning", "jazzy") == {("no-layer", "")}
    assert told(text[:-1] + ", rmw_layer: false}", "warning", "jazzy") == set()
    made = find(release(text, distro="jazzy", libraries={}), "Deployment", "n")
    assert made["metadata"]["annotations"]["rigel-k8s/update"].startswith("Recreate: this inst")
    assert made["spec"]["template"]["spec"]["containers"][0]["args"] == [
        "x",
        "--ros-args",
        "-r",
        "__node:=n",
    ]


def test_without_the_library_hand_over_cannot_be_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reason is that of the installation."""
    monkeypatch.setattr("rigel_k8s.app.generations.ros2.libraries", dict)
    text = "{image: a, network: peers, nodes: {n: {args: x, update: {strategy: HandOver}}}}"
    [found] = [one for one in problems(text, "jazzy") if one.kind == "hand-over"]
    assert "built without ziglang" in found.message


#: What is said of a node on its machine's network, by mode; docs/network-modes.md shows it.
ON_MACHINE = {
    "network: peers": set(),
    "network: discovery-server": set(),
    "network: zenoh": set(),
    "network: host": set(),
    "network: none": set(),
    LAN: {("conflict", "nodes.n.host_network")},
    "network: {mode: attachment, attachment: a}": {("conflict", "nodes.n.host_network")},
}


@pytest.mark.parametrize("network", ON_MACHINE)
def test_a_node_on_its_machines_network_is_refused_by_a_second_network_only(network: str) -> None:
    """Multus attaches nothing to it."""
    update = "update: {strategy: Recreate}"
    nodes = f"{{n: {{args: x, host_network: true, {update}}}, o: {{args: x, {update}}}}}"
    text = f"{{image: a, {network}, nodes: {nodes}}}"
    assert told(text, "error", "jazzy") == ON_MACHINE[network]
    assert told(text, "warning", "jazzy") == set()


def test_without_a_network_there_is_a_warning_for_a_node_on_its_machines_network_too() -> None:
    """It hears the others as little as they hear each other."""
    text = "{image: a, nodes: {n: {args: x, host_network: true}, o: {args: x}}}"
    assert told(text, "warning", "jazzy") == {("network-missing", "nodes")}
    assert told(text, "error", "jazzy") == set()


def test_hand_over_is_for_ros2_programs_of_a_known_line() -> None:
    """Neither for the one application, whose line is unknown, nor for plain DDS."""

    def node(update: str, more: str = "") -> str:
        return f"{{{more}image: a, {LAN}, nodes: {{n: {{args: x, update: {{{update}}}}}}}}}"

    assert told(node("strategy: HandOver"), "error", "jazzy") == set()
    text = f"{{application_image: a, {LAN}, rolling_update: {{strategy: HandOver}}}}"
    assert told(text, "error", "jazzy") == {("hand-over", "rolling_update.strategy")}
    text = node("strategy: HandOver", "ros: none, ")
    assert told(text, "error", "jazzy") == {("hand-over", "nodes.n.update.strategy")}


@pytest.mark.parametrize("key", ["parameters", "parameter_files", "parameter_commands"])
@pytest.mark.parametrize("distro", ["jazzy", "dds"])
def test_only_ros1_has_global_parameters(key: str, distro: str) -> None:
    """The remedy is the nodes' own option of the same name."""
    value = {"parameter_files": "[a.yaml]", "parameter_commands": "{a: b}"}.get(key, "{a: 1}")
    ros = "2" if distro == "jazzy" else "none"
    text = f"{{image: a, ros: '{ros}', network: none, nodes: {{n: {{args: x}}}}, {key}: {value}}}"
    assert told(text, "error", "jazzy") == {("no-global-parameters", key)}


def test_ros2_has_no_namespaces_of_parameters() -> None:
    """And ros2 launch reads neither files nor commands."""

    def node(text: str) -> str:
        return f"{{image: a, nodes: {{n: {text}}}}}"

    text = node("{args: x, parameter_files: [{file: a.yaml, namespace: b}]}")
    assert told(text, "error", "jazzy") == {
        ("no-parameter-namespace", "nodes.n.parameter_files.0.namespace")
    }
    text = node("{launch: {file: x}, parameter_commands: {a: b}}")
    assert told(text, "error", "jazzy") == {("not-appendable", "nodes.n.parameter_commands")}


def test_anonymous_nodes_may_be_many_and_surge() -> None:
    """Their names differ, so nothing is thrown out."""
    text = "{image: a, nodes: {my-node: {anonymous: true, replicas: 3, update: {max_surge: 1}}}}"
    assert problems(text) == []


def test_a_partial_job_is_not_asked_for_the_rest() -> None:
    """src.plugin's update_k8s has nothing but these two keys."""
    text = "{rolling_update: {strategy: Recreate}, readiness: {command: /ready}}"
    assert problems(text) == []


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.with.yaml")), ids=lambda p: p.name)
def test_golden_options_have_no_errors(path: object) -> None:
    """The shapes that are documented by golden files pass the checks."""
    text = (GOLDEN / str(path)).read_text("utf-8")
    assert [p for p in problems(text) if p.severity == "error"] == []


@pytest.mark.parametrize("update", ["", ", update: {strategy: HandOver}"])
def test_a_line_that_cannot_be_split_is_no_bug_of_ours(update: str) -> None:
    """For ROS 2 too, where the line decides whether a node can be handed over."""
    node = f'{{package: p, executable: e, args: "\'"{update}}}'
    found = problems(f"image: a:1\nnetwork: peers\nnodes: {{a: {node}}}", "jazzy")
    expected = ["hand-over"] * bool(update) + ["bad-command"]
    assert [problem.kind for problem in found] == expected


@pytest.mark.parametrize(
    ("node", "warns"),
    [
        ("args: [ros2, bag, record, -a], anonymous: true", True),
        ("args: [bash, -c, cd /bags && exec ros2 bag record -a], anonymous: true", True),
        ("package: foxglove_bridge, executable: foxglove_bridge", True),
        ("launch: {package: rosbridge_server, file: a.launch.xml}", True),
        ("args: [ros2, bag, record], anonymous: true, env: {ROS_SUPER_CLIENT: 'TRUE'}", False),
        (
            "args: [ros2, bag, record], anonymous: true,"
            " env: [{name: ROS_SUPER_CLIENT, value: 'TRUE'}]",
            False,
        ),
        ("args: [bash, -c, ROS_SUPER_CLIENT=TRUE ros2 bag record], anonymous: true", False),
        ("args: [ros2, bag, play, /bag], anonymous: true", False),
    ],
)
def test_a_tool_is_a_super_client_of_discovery_servers(
    node: str,
    warns: bool,  # noqa: FBT001 - a parameter
) -> None:
    """With another mode it sees the graph anyway."""
    for mode, here in (("discovery-server", warns), ("peers", False)):
        text = f"{{image: lab/a:1, network: {mode}, nodes: {{b: {{{node}}}}}}}"
        assert (("no-super-client", "nodes.b") in told(text, "warning", "jazzy")) == here


def test_a_rollback_of_expectations_has_its_time() -> None:
    """`within` is that of both."""
    text = (
        "{image: a, ros: '2', nodes: {b: {args: x}},"
        " expect: {/a: {rate: 1, else: rollback}}, rollback_on: {within: 5s}}"
    )
    assert told(text, "error") == set()

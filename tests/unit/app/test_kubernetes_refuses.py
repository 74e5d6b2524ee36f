"""What only the cluster would refuse has its place in the Rigelfile."""

from __future__ import annotations

import pytest

from .shapes import problems

LAN = "ros: '2', network: {mode: macvlan, interface: eth0, subnet: 10.20.0.0/24}"
NETWORKS = "k8s.v1.cni.cncf.io/networks"
MULTUS = f"patch: {{spec: {{template: {{metadata: {{annotations: {{{NETWORKS}: %s}}}}}}}}}}"
POD = "patch: {spec: {template: {spec: {%s}}}}"
STORE = "persistent_storage: {volumes: [{name: v}, {name: w, mount_path: /w}]}"
MEMORY = "{memory: 1Mi, mount_path: %s}"
POD_PATH = "patch.spec.template.spec."
PRIVILEGED = "security_context: {privileged: true}"
GPU_NAME = "nvidia.com/gpu"
GPU = f"{{{GPU_NAME}: %s}}"
FIELD = "valueFrom: {fieldRef: {fieldPath: %s}}"
#: The job, a node, the kind, and the place below the node; "" for none.
CASES = [
    ("", f"volumes: [{MEMORY % '/a'}, {MEMORY % '/a/'}]", "conflict", "volumes.1"),
    ("", f"volumes: [{MEMORY % '/a'}, {MEMORY % '/a/b'}]", "", ""),
    (STORE, f"volumes: [v, {MEMORY % '/persistent/v'}]", "conflict", "volumes.1"),
    (STORE, "volumes: [w, {name: v, mount_path: /w}]", "conflict", "volumes.1"),
    ("", f"volumes: [{MEMORY % '/rigel-k8s'}]", "conflict", "volumes.0"),
    (LAN, f"volumes: [{MEMORY % '/etc/machine-id'}]", "conflict", "volumes.0"),
    (f"{LAN}, middleware: cyclonedds", f"volumes: [{MEMORY % '/etc/machine-id'}]", "", ""),
    ("", f"volumes: [{MEMORY % '/etc/machine-id'}]", "", ""),
    (
        "",
        f"devices: [/dev/a, /dev/a], {'security_context: {privileged: true}'}",
        "conflict",
        "devices.1",
    ),
    ("", "ports: [80, 80]", "conflict", "ports.1"),
    ("", "ports: [80, {port: 80, protocol: UDP}]", "", ""),
    ("", "ports: [{port: 80, name: a}, {port: 81, name: a}]", "conflict", "ports.1"),
    ("", "ports: [80, {port: 81, service_port: 80}]", "conflict", "ports.1"),
    ("", "service_type: NodePort", "incomplete", "service_type"),
    ("", "ports: [80], service_type: NodePort", "", ""),
    ("", "resources: {limits: {gpu: 1}}", "bad-resource", "resources.limits.gpu"),
    ("", "resources: {limits: {memmory: 1Gi}}", "bad-resource", "resources.limits.memmory"),
    ("", "resources: {limits: {hugepages-2Mi: 4Mi, nvidia.com/gpu: 1}}", "", ""),
    ("", "resources: {limits: {memory: 512m}}", "bad-quantity", "resources.limits.memory"),
    (
        "",
        "resources: {requests: {cpu: 2}, limits: {cpu: 1}}",
        "conflict",
        "resources.requests.cpu",
    ),
    (
        "",
        "security_context: {capabilities: {add: [NET_ADMIN, CAP_SYS_NICE]}}",
        "bad-name",
        "security_context.capabilities.add.1",
    ),
    ("", "security_context: {privileged: 'true'}", "wrong-type", "security_context.privileged"),
    ("", "security_context: {runAsUser: robot}", "wrong-type", "security_context.runAsUser"),
    ("", "security_context: {priviledged: true}", "unknown-key", "security_context.priviledged"),
    ("", "security_context: {runAsUser: 1000, seccompProfile: {type: x}}", "", ""),
    (
        "",
        "volumes: [{secret: s, mount_path: /a, sub_path: ../x}]",
        "bad-path",
        "volumes.0.sub_path",
    ),
    ("", "volumes: [{secret: s, mount_path: /a, sub_path: x/..y}]", "", ""),
    ("", f"volumes: [{MEMORY % '/'}]", "conflict", "volumes.0"),
    ("", f"volumes: [{MEMORY % '/a'}], files: {{/a: b}}", "conflict", "volumes.0"),
    ("", "files: {/rigel-k8s: a}", "conflict", "files./rigel-k8s"),
    (LAN, "files: {/etc/machine-id: a}", "conflict", "files./etc/machine-id"),
    ("", "files: {/a: b, /a/: c}", "conflict", "files./a/"),
    ("", f"devices: [/dev/a], {PRIVILEGED}, files: {{/dev/a: b}}", "conflict", "devices.0"),
    *(
        ("", f"resources: {{{given}}}", kind, f"resources.{place}")
        for given, kind, place in (
            (f"requests: {GPU % 1}", "conflict", f"requests.{GPU_NAME}"),
            (f"requests: {GPU % 1}, limits: {GPU % 2}", "conflict", f"requests.{GPU_NAME}"),
            (f"limits: {GPU % 0.5}", "bad-quantity", f"limits.{GPU_NAME}"),
            ("requests: {hugepages-2Mi: 4Mi}", "conflict", "requests.hugepages-2Mi"),
            ("limits: {ephemeral-storage: 512m}", "bad-quantity", "limits.ephemeral-storage"),
        )
    ),
    ("", f"resources: {{requests: {GPU % 1}, limits: {GPU % 1}}}", "", ""),
    *(
        ("", f"tolerations: [{{{one}}}]", "bad-toleration" if wrong else "", "tolerations.0")
        for one, wrong in (
            ("key: a, operator: Exists, value: b", True),
            ("operator: Equal, value: b", True),
            ("value: b", True),
            ("key: a, seconds: 3", True),
            ("key: a, seconds: 3, effect: NoSchedule", True),
            ("key: a, seconds: 3, effect: NoExecute", False),
            ("key: a, operator: Equal", False),
            ("operator: Exists", False),
        )
    ),
    *(
        ("", f"env: [{{name: A, {one}}}]", kind, f"env.0.{place}")
        for one, kind, place in (
            (f"value: a, {FIELD % 'status.podIP'}", "conflict", "valueFrom"),
            ("valueFrom: {}", "conflict", "valueFrom"),
            (FIELD % "status.ip", "bad-field", "valueFrom.fieldRef.fieldPath"),
            (FIELD % "spec.nodename", "bad-field", "valueFrom.fieldRef.fieldPath"),
            (FIELD % "\"metadata.labels['a']\"", "", ""),
            (FIELD % "status.hostIP", "", ""),
        )
    ),
    (
        "",
        "security_context: {privileged: true, allowPrivilegeEscalation: false}",
        "conflict",
        "security_context.allowPrivilegeEscalation",
    ),
    (
        "",
        "security_context: {runAsNonRoot: true, runAsUser: 0}",
        "conflict",
        "security_context.runAsUser",
    ),
    ("", "security_context: {runAsNonRoot: true, runAsUser: 1}", "", ""),
    (
        "",
        POD % "containers: [{name: ros-node, securityContext: {capabilities: {add: [CAP_A]}}}]",
        "bad-name",
        POD_PATH + "containers.0.securityContext.capabilities.add.0",
    ),
    *(
        ("", f"placement: {{node: a, labels: {{kubernetes.io/hostname: {name}}}}}", kind, place)
        for name, kind, place in (
            ("b", "conflict", "placement.labels.kubernetes.io/hostname"),
            ("a", "", ""),
        )
    ),
    ("", "patch: {kind: DaemonSet}", "fixed-field", "patch.kind"),
    ("", POD % "restartPolicy: Never", "fixed-field", POD_PATH + "restartPolicy"),
    ("", f"kind: task, {POD % 'restartPolicy: OnFailure'}", "", ""),
    ("", f"kind: task, {POD % 'restartPolicy: Always'}", "fixed-field", POD_PATH + "restartPolicy"),
    (
        "",
        "patch: {spec: {template: {metadata: {labels: {app.kubernetes.io/name: a, app: a}}}}}",
        "fixed-field",
        "patch.spec.template.metadata.labels.app.kubernetes.io/name",
    ),
    (
        "",
        "patch: {metadata: {labels: {rigel-k8s/release: a, app.kubernetes.io/part-of: a}}}",
        "fixed-field",
        "patch.metadata.labels.rigel-k8s/release",
    ),
    ("", POD % "containers: [{name: n, tty: true}]", "missing-image", POD_PATH + "containers"),
    ("ros: '2'", POD % "containers: [{name: n}]", "missing-image", POD_PATH + "containers"),
    ("", POD % "containers: [{name: n, image: a}]", "", ""),
    (
        "",
        POD % "containers: [{name: ros-node, image: A B}]",
        "bad-image",
        POD_PATH + "containers.0.image",
    ),
    ("", "patch: {spec: {replicas: 2}}", "patched", "patch.spec.replicas"),
    ("", "anonymous: true, patch: {spec: {replicas: 2}}", "", ""),
    ("", "patch: {spec: {replicas: 0}}", "", ""),
    ("", "patch: {kind: Deployment, apiVersion: apps/v1}", "", ""),
    ("", POD % "hostnetwork: true", "unknown-key", "patch.spec.template.spec.hostnetwork"),
    ("", POD % "hostNetwork: true, newField: 1", "", ""),
    (
        "",
        POD % "containers: [{name: ros-node, workdir: /a}]",
        "unknown-key",
        "patch.spec.template.spec.containers.0.workdir",
    ),
    (
        "",
        "patch: {metadata: {annotations: {a: 1}}}",
        "wrong-type",
        "patch.metadata.annotations.a",
    ),
    ("", "patch: {metadata: {annotations: {a: '1', b: null}}}", "", ""),
    ("", "patch: {hostNetwork: true}", "unknown-key", "patch.hostNetwork"),
    ("", "patch: {spec: {nodeName: r}}", "unknown-key", "patch.spec.nodeName"),
    (LAN, MULTUS % "other", "conflict", "patch.spec.template.metadata.annotations." + NETWORKS),
    (LAN, MULTUS % "other@net1", "", ""),
    ("", MULTUS % "other", "", ""),
]


@pytest.mark.parametrize(("job", "node", "kind", "place"), CASES)
def test_it_is_refused_before(job: str, node: str, kind: str, place: str) -> None:
    text = f"{{image: a, {job}{',' * bool(job)} nodes: {{n: {{args: x, {node}}}}}}}"
    found = [p for p in problems(text) if p.severity == "error"]
    expected = [(kind, f"nodes.n.{place}")] if kind else []
    assert [(p.kind, ".".join(map(str, p.path))) for p in found] == expected


@pytest.mark.parametrize(
    ("job", "node", "words"),
    [
        ("", "host_network: true", "ports of its machine already"),
        ("network: host", "", "ports of its machine already"),
        (LAN, "", "the second network reaches the node"),
        ("", "", None),
    ],
)
def test_a_node_that_is_reached_anyway_needs_no_type(
    job: str, node: str, words: str | None
) -> None:
    """Of its Service; one that is reached from the cluster alone opens nothing."""
    for kind, expected in (("NodePort", words), ("LoadBalancer", words), ("ClusterIP", None)):
        text = f"{{image: a, {job}{',' * bool(job)} nodes: {{n: {{args: x, ports: [80], {node}"
        found = problems(f"{text}{',' * bool(node)} service_type: {kind}}}}}}}")
        messages = [p.message for p in found if p.kind == "reachable"]
        assert [expected in one for one in messages if expected] == [True] * bool(expected)
        assert len(messages) == bool(expected)


@pytest.mark.parametrize(
    ("field", "option"),
    [
        ("spec: {replicas: 0}", None),
        ("spec: {strategy: {type: Recreate}}", "`update`"),
        ("spec: {template: {spec: {hostNetwork: true}}}", "`host_network`"),
        ("spec: {template: {spec: {hostNetwork: false}}}", None),
        ("spec: {template: {spec: {hostPID: true}}}", None),
    ],
)
def test_a_patch_has_no_option_of_the_node(field: str, option: str | None) -> None:
    """It would get no DNS of the cluster, or no second interface, and its updates other ones."""
    found = [
        one
        for one in problems(f"{{image: a, nodes: {{n: {{args: x, patch: {{{field}}}}}}}}}")
        if one.kind == "patched"
    ]
    assert [one.severity for one in found] == (["warning"] if option else [])
    assert all(str(option) in one.message for one in found)


#: A job, and the place of a size that has no unit, or a wrong one; "" for none.
SIZES = [
    ("persistent_storage: {volumes: [{name: v, size: 20}]}", "persistent_storage.volumes.0.size"),
    ("persistent_storage: {volumes: [{name: v, size: 1m}]}", "persistent_storage.volumes.0.size"),
    ("persistent_storage: {volumes: [{name: v, size: 20Gi}]}", ""),
    (
        "observability: {enabled: true, loki: {persistence: {size: 10}}}",
        "observability.loki.persistence.size",
    ),
]


@pytest.mark.parametrize(("job", "place"), SIZES)
def test_a_size_has_its_unit(job: str, place: str) -> None:
    found = [one for one in problems(f"{{{job}}}") if one.kind == "bad-quantity"]
    assert [".".join(map(str, one.path)) for one in found] == ([place] if place else [])


def test_roscore_has_a_container_of_its_own_name() -> None:
    """One of another name would be a further one, and need an image."""
    patch = "{spec: {template: {spec: {containers: [{name: %s, tty: true}]}}}}"
    for name, kinds in (("roscore", ["missing-image"]), ("ros-master-container", [])):
        text = f"{{image: a, additional_k8s_params: {{ros_master: {patch % name}}}}}"
        assert [p.kind for p in problems(text) if p.severity == "error"] == kinds


def test_a_device_is_opened_by_a_privileged_patch_too() -> None:
    patch = "{spec: {template: {spec: {containers: [{name: ros-node, %s}]}}}}"
    node = "{args: x, devices: [/dev/a], placement: {node: r}, patch: %s}"
    own = patch % "securityContext: {privileged: true}"
    for one, kinds in ((own, []), (patch % "tty: true", ["device-access"])):
        assert [p.kind for p in problems(f"{{image: a, nodes: {{n: {node % one}}}}}")] == kinds


def test_one_mistake_of_a_line_or_a_volume_is_one_problem() -> None:
    line = "{image: a, ros: '2', nodes: {n: {args: 'x \"y', lifecycle: {start: [configure]}}}}"
    assert [p.kind for p in problems(line) if p.severity == "error"] == ["bad-command"]

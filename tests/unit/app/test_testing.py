"""Nodes that run once: tasks, and tests, which a deploy leaves out."""

from __future__ import annotations

import json

import pytest
import yaml

from rigel_k8s.app.generation import generation_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.testing import choose_nodes, find_collisions, make_test_pod

from .shapes import find, options, problems, release

NODES = "talker: {args: [talk]}, hears: {kind: test, args: [hear], env: {WORD: hello}}"
TEXT = f"{{image: robot:1, network: peers, nodes: {{{NODES}}}}}"
PLAIN = "{image: robot:1, network: peers, nodes: {talker: {args: [talk]}}}"


def to_test(made: OrchestrationOptions) -> OrchestrationOptions:
    """Return options whose tests have no pods."""
    return choose_nodes(made, {}, tests=True)[0]


def test_a_deploy_leaves_it_out() -> None:
    """Of the options, and of what the revision keeps of them, in both shapes."""
    raw = yaml.safe_load(TEXT)
    for written in (raw, {"orchestration": raw}):
        made, kept = choose_nodes(options(TEXT), written, tests=False)
        assert made == options(PLAIN)
        assert kept == yaml.safe_load(PLAIN)
    assert "hears" in raw["nodes"]  # what was given is not changed


def test_without_a_test_nothing_changes() -> None:
    raw = yaml.safe_load(PLAIN)
    assert choose_nodes(options(PLAIN), raw, tests=False) == (options(PLAIN), raw)


def test_its_pod_is_that_of_its_job_with_a_reader() -> None:
    objects = release(TEXT, distro="jazzy", change=to_test)
    job = find(objects, "Job", "hears")
    assert job["spec"]["suspend"] is True
    assert job["metadata"]["annotations"]["rigel-k8s/test"] == "true"
    template = job["spec"]["template"]
    labels = dict(template["metadata"]["labels"])
    # What Kubernetes adds: a Job takes a pod with these for its own, and a suspended one ends it.
    added = {"batch.kubernetes.io/controller-uid": "1"}
    job["spec"]["selector"] = {"matchLabels": added}
    template["metadata"]["labels"] |= added
    pod = make_test_pod(job)
    assert pod["metadata"]["name"] == "hears"
    assert pod["metadata"]["labels"] == labels
    assert pod["spec"]["restartPolicy"] == "Never"
    node, reader = pod["spec"]["containers"]
    own = template["spec"]["containers"][0]
    for key in ("image", "args", "command", "env"):
        assert node.get(key) == own.get(key)
    assert not {"startupProbe", "readinessProbe", "livenessProbe"} & node.keys()
    assert reader["image"] == node["image"]
    assert reader["volumeMounts"] == [node["volumeMounts"][-1]]
    assert reader["volumeMounts"][0]["mountPath"] == "/results"
    assert template["spec"]["containers"] == [own]  # the Job is not changed


@pytest.mark.parametrize(("distro", "network"), [("jazzy", "network: peers, "), ("noetic", "")])
def test_a_task_is_a_job_with_the_pod_of_a_node(distro: str, network: str) -> None:
    """The same pod but for probes, hand-over and the end, after which it is not started again."""
    text = (
        f"{{image: robot:1, {network}security: restricted, nodes: {{a: {{%s args: [a],"
        " env: {B: c}, ports: [80]}}}"
    )
    made = release(text % "kind: task, ", distro=distro)
    task, node = find(made, "Job", "a"), find(release(text % "", distro=distro), "Deployment", "a")
    assert task["apiVersion"] == "batch/v1"
    assert task["spec"].keys() == {"backoffLimit", "template"}
    assert task["spec"]["backoffLimit"] == 0
    template, other = task["spec"]["template"], node["spec"]["template"]
    assert template["metadata"] == other["metadata"]
    assert template["spec"].pop("restartPolicy") == "Never"
    once, lasting = template["spec"].pop("containers"), other["spec"].pop("containers")
    other["spec"].pop("terminationGracePeriodSeconds", None)  # a hand-over's
    assert template["spec"] == other["spec"]
    for key in ("startupProbe", "readinessProbe"):
        assert lasting[0].pop(key)
        assert key not in once[0]
    handed = {one["name"] for one in lasting[0].pop("env")} - {
        one["name"] for one in once[0].pop("env")
    }
    assert once == lasting
    assert all(name.startswith("RIGEL") or name == "ROS_MASTER_URI" for name in handed)
    assert (
        find(made, "Service", "a")["spec"]["selector"].items()
        <= template["metadata"]["labels"].items()
    )


def test_a_tool_of_ros1_gets_no_argument_that_it_misreads() -> None:
    """rosparam ends with "too many arguments", and rosservice passes it on as a value."""
    for line in (["rosparam", "set", "/a", "1"], ["rosservice", "call", "/a"]):
        text = f"{{image: r:1, nodes: {{a: {{kind: task, args: {line}}}}}}}"
        job = find(release(text), "Job", "a")
        assert job["spec"]["template"]["spec"]["containers"][0]["args"] == line
        assert "rigel-k8s/ros-name" not in job["metadata"]["annotations"]


def test_a_task_may_name_its_node_itself() -> None:
    """`ros2 bag play` does: no ROS name is promised, and none is advised to be set."""
    text = "{image: r:1, network: peers, nodes: {bag: {kind: task, args: ros2 bag play /b}}}"
    assert problems(text, "jazzy") == []
    notes = find(release(text, distro="jazzy"), "Job", "bag")["metadata"]["annotations"]
    assert notes == {"rigel-k8s/node": "bag"}


def test_a_patch_of_a_task_is_one_of_its_job() -> None:
    text = "{image: r:1, network: peers, nodes: {a: {kind: task, args: [a], patch: %s}}}"
    patch = "{spec: {backoffLimit: 2, template: {spec: {hostname: x}}}}"
    assert problems(text % patch, "jazzy") == []
    spec = find(release(text % patch, distro="jazzy"), "Job", "a")["spec"]
    assert (spec["backoffLimit"], spec["template"]["spec"]["hostname"]) == (2, "x")
    [wrong] = problems(text % "{spec: {backoffLimits: 2}}", "jazzy")
    assert wrong.message == 'unknown field "backoffLimits", did you mean "backoffLimit"?'
    [other] = problems(text % "{kind: Deployment}", "jazzy")
    assert other.message == "kind of a Job is Job: remove it"


def test_the_exporter_knows_a_task_and_does_not_expect_it() -> None:
    text = "{observability: {enabled: true}, image: r:1, network: peers, nodes: {%s}}"
    both = "talker: {args: [a]}, once: {kind: task, args: [b]}"
    made = release(text % both, distro="jazzy")
    data = find(made, "ConfigMap", "rigel-k8s-application-ros-exporter")["data"]
    config = json.loads(next(iter(data.values())))
    assert config["expected"] == {"/talker": "talker"}
    assert (config["known"], config["once"]) == ({"/once": "once"}, ["/once"])
    assert "once-pods" in str(config)


def test_the_exporter_expects_no_test() -> None:
    """It would be missing before it begins, and when it has ended."""
    text = TEXT.replace("{image", "{observability: {enabled: true}, image", 1)
    made = release(text, distro="jazzy", change=to_test)
    config = find(made, "ConfigMap", "rigel-k8s-application-ros-exporter")["data"]
    assert "/talker" in str(config)
    assert "/hears" not in str(config)
    assert "hears-pods" not in str(config)  # its keeper


def test_what_has_no_effect_on_it_is_refused() -> None:
    text = (
        "{image: robot:1, network: peers, nodes: {hears: {kind: test, args: [hear], replicas: 1,"
        " update: {strategy: Recreate}, pod: one}}}"
    )
    found = [p for p in problems(text, "jazzy") if p.kind == "test"]
    assert [p.path for p in found] == [
        ("nodes", "hears", key) for key in ("pod", "replicas", "update")
    ]
    assert found[0].message == (
        "`pod` is for nodes that work on, and this is a test, which ends: remove it"
    )


def list_shared(text: str, distro: str = "jazzy") -> list[str]:
    """Return the paths of what two deploys at the same time share."""
    made = options(f"{{image: robot:1, {text}}}")
    found = find_collisions(made, generation_of(distro, made.ros))
    return [".".join(map(str, path)) for path, _ in found]


@pytest.mark.parametrize("mode", ["peers", "discovery-server", "zenoh"])
def test_what_is_in_a_namespace_is_not_shared(mode: str) -> None:
    """Claims, memory, ConfigMaps, what is only read, devices of a plugin."""
    volumes = "[{memory: 1Gi, mount_path: /a}, {host_path: /m, mount_path: /m, read_only: true}]"
    node = f"{{args: [a], devices: [{{resource: a.b/c}}], volumes: {volumes}}}"
    storage = "persistent_storage: {volumes: [{name: maps}]}"
    assert list_shared(f"network: {mode}, {storage}, nodes: {{a: {node}}}") == []
    assert list_shared("nodes: {a: {args: [a]}}", "noetic") == []


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("network: host", "network"),
        ("network: {mode: host, shared_memory: true}", "network.mode"),
        ("network: {interface: eth0, subnet: 10.1.0.0/24}", "network.mode"),
        ("network: {mode: attachment, attachment: lan}", "network.mode"),
        ("network: {mode: peers, domain_id: 7}", "network.domain_id"),
        ("network: none", "network"),
        ("nodes: {a: {args: [a]}}", ""),
        ("network: peers, ros: none", "network"),
        ("network: peers, persistent_storage: {volumes: [{name: maps, host_path: /maps}]}",)
        + ("persistent_storage.volumes.0.host_path",),
        ("network: peers, record: {host_path: /bags}", "persistent_storage.volumes.0.host_path"),
        ("network: peers, results: {source_path: /out}", "results"),
        ("network: peers, nodes: {a: {host_network: true}}", "nodes.a.host_network"),
        ("network: peers, nodes: {a: {devices: [/dev/ttyUSB0]}}", "nodes.a.devices"),
        ("network: peers, nodes: {a: {volumes: [{host_path: /m, mount_path: /m}]}}",)
        + ("nodes.a.volumes.0",),
    ],
)
def test_what_is_of_the_cluster_or_a_machine_is_shared(text: str, path: str) -> None:
    assert list_shared(text) == [path]


def test_a_master_of_the_users_own_is_shared() -> None:
    assert list_shared("ros_master_uri: http://robot:11311", "noetic") == ["ros_master_uri"]
    assert list_shared("network: host", "noetic") == ["network"]

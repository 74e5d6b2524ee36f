"""Nodes of `kind: test`: left out by a deploy, and one pod of their Deployment for `rigel test`."""

from __future__ import annotations

import pytest
import yaml

from rigel_k8s.app.generation import generation_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.testing import choose_nodes, find_shared, make_test_pod

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


def test_to_be_tested_it_has_no_pod_and_disturbs_none() -> None:
    made = to_test(options(TEXT))
    asleep = made.nodes["hears"]
    assert (asleep.replicas, asleep.readiness) == (0, "none")
    assert asleep.update is not None
    assert asleep.update.strategy == "Recreate"
    assert made.nodes["talker"] == options(PLAIN).nodes["talker"]


def test_its_pod_is_that_of_its_deployment_but_ends() -> None:
    objects = release(TEXT, distro="jazzy", change=to_test)
    deployment = find(objects, "Deployment", "hears")
    assert deployment["spec"]["replicas"] == 0
    assert deployment["metadata"]["annotations"]["rigel-k8s/test"] == "true"
    template = deployment["spec"]["template"]
    pod = make_test_pod(deployment)
    assert pod["metadata"]["name"] == "hears"
    assert pod["metadata"]["labels"] == template["metadata"]["labels"]
    assert pod["spec"]["restartPolicy"] == "Never"
    node, reader = pod["spec"]["containers"]
    own = template["spec"]["containers"][0]
    for key in ("image", "args", "command", "env"):
        assert node.get(key) == own.get(key)
    assert not {"startupProbe", "readinessProbe", "livenessProbe"} & node.keys()
    assert reader["image"] == node["image"]
    assert reader["volumeMounts"] == [node["volumeMounts"][-1]]
    assert reader["volumeMounts"][0]["mountPath"] == "/results"
    assert template["spec"]["containers"] == [own]  # the Deployment is not changed


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
    found = find_shared(made, generation_of(distro, made.ros))
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

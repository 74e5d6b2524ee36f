"""`security: restricted`: all pods pass the level, and what a Rigelfile sets itself stays."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.podsecurity import find_violations
from rigel_k8s.release.types import Desired
from tests.support.podsecurity import list_missing

from .shapes import GOLDEN, find, pod, problems, release

FILES = {
    "config/planner.yaml": "speed: 1\n",
    "config/common.yaml": "frame: map\n",
    "config/ros2.yaml": "/ns/listener:\n  ros__parameters:\n    queue: 1e3\n",
}
NODES = "image: a\nnodes: {talker: {args: [talk]}, listener: {args: [hear]}}\n"
SERVERS = {
    "discovery": f"# distro: jazzy\n{NODES}network: {{mode: discovery-server, servers: 2}}\n",
    "zenoh": f"# distro: jazzy\n{NODES}network: zenoh\n",
    "macvlan": f"# distro: jazzy\n{NODES}"
    "network: {mode: macvlan, interface: eth0, subnet: 10.1.0.0/24}\n",
}


def restricted(text: str) -> str:
    """Return the options with the level."""
    return text.rstrip() + "\nsecurity: restricted\n"


def allowed() -> dict[str, str]:
    """Return the golden options that the level allows, by name."""
    found = {p.name: p.read_text("utf-8") for p in sorted(GOLDEN.glob("*.with.yaml"))}
    found = {name: text for name, text in found.items() if "\nsecurity:" not in text}
    return {
        name: text
        for name, text in found.items()
        if not any(p.kind == "restricted" for p in problems(restricted(text)))
    }


ALLOWED = allowed() | SERVERS


WORKLOADS = ("Deployment", "Job")


def pods(made: Desired) -> list[dict[str, Any]]:
    """Return the specs of all pods of a release."""
    return [item["spec"]["template"]["spec"] for item in made.objects if item["kind"] in WORKLOADS]


@pytest.mark.parametrize("case", ALLOWED)
def test_all_pods_of_a_release_pass_the_level(case: str) -> None:
    """Nodes, roscore, gate, exporter, servers and init containers: none is forgotten."""
    made = pods(release(restricted(ALLOWED[case]), files=FILES))
    assert made or "observability_only" in ALLOWED[case]
    for spec in made:
        assert list(find_violations(spec)) == []
        assert list_missing(spec) == []
        mounted = {m["name"] for c in spec["containers"] for m in c.get("volumeMounts", ())}
        names = [volume["name"] for volume in spec["volumes"]]
        assert mounted <= set(names)
        assert len(names) == len(set(names))


def test_most_shapes_are_allowed() -> None:
    """The test above is about more than a few."""
    assert len(ALLOWED) > 15


@pytest.mark.parametrize("case", [name for name in ALLOWED if name not in SERVERS])
def test_only_what_has_pods_changes(case: str) -> None:
    """Services, claims and ConfigMaps are the same with and without the level."""

    def others(text: str) -> list[Any]:
        made = release(text, files=FILES).objects
        return [item for item in made if item["kind"] not in WORKLOADS]

    assert others(restricted(ALLOWED[case])) == others(ALLOWED[case])


def test_a_volume_of_the_same_name_stays_as_it_is() -> None:
    """A patch may choose another medium for what is written."""
    own = {"name": "rigel-tmp", "emptyDir": {"medium": "Memory"}}
    made = release(
        restricted(
            "image: a\nnodes: {n: {args: [x], patch: {spec: {template: {spec: {volumes:"
            " [{name: rigel-tmp, emptyDir: {medium: Memory}}]}}}}}}"
        )
    )
    assert [v for v in pod(made, "n")["volumes"] if v["name"] == "rigel-tmp"] == [own]


def test_no_volume_is_added_that_no_container_uses() -> None:
    """A node's own /tmp takes the place of ours."""
    made = release(
        restricted(
            "image: a\nnodes: {t: {args: [t]}, n: {ros: none, args: [x],"
            " volumes: [{memory: 1Mi, mount_path: /tmp}]}}"
        )
    )
    names = {volume["name"] for volume in pod(made, "n")["volumes"]}
    assert "rigel-home" in names
    assert "rigel-tmp" not in names


def test_the_first_directories_belong_to_the_nodes_own_user() -> None:
    """Who makes HOME's directories is who writes to them."""
    made = release(
        restricted("image: a\nnodes: {n: {args: [x], security_context: {runAsUser: 5}}}")
    )
    [home] = pod(made, "n")["initContainers"]
    assert home["securityContext"]["runAsUser"] == 5


@pytest.mark.parametrize(("source", "warned"), [("10.0.0.0/8", False), ("other", True)])
def test_addresses_let_pods_on_the_machines_network_in(source: str, warned: Any) -> None:
    """A release does not: such pods have the machine's address."""
    found = problems(
        "image: a\nnodes: {n: {args: [x], host_network: true}}\n"
        f"network_policy: {{allow: [{source}]}}"
    )
    assert ("not-covered" in {problem.kind for problem in found}) is warned


def test_an_address_in_a_range_stands_for_the_range() -> None:
    """Kubernetes takes nothing else."""
    made = release("image: a\nnetwork_policy: {allow: [192.168.1.5/24]}\nnodes: {n: {args: [x]}}")
    [rule] = find(made, "NetworkPolicy", made.release.name)["spec"]["ingress"]
    assert {"ipBlock": {"cidr": "192.168.1.0/24"}} in rule["from"]


def test_a_port_of_a_service_of_the_outside_is_open_to_all() -> None:
    """That port alone, and of a node whose Service is for pods none."""
    nodes = "web: {args: [x], ports: [80, {port: 9, protocol: UDP}], service_type: %s}"
    text = (
        f"{{image: a, network_policy: true, nodes: {{{nodes}, other: {{args: [x], ports: [7]}}}}}}"
    )
    for kind in ("NodePort", "LoadBalancer"):
        made = release(text % kind)
        assert find(made, "Service", "web")["spec"]["type"] == kind
        assert "type" not in find(made, "Service", "other")["spec"]
        spec = find(made, "NetworkPolicy", "rigel-k8s-application-web")["spec"]
        assert spec["ingress"] == [
            {"ports": [{"port": 80, "protocol": "TCP"}, {"port": 9, "protocol": "UDP"}]}
        ]
        assert spec["podSelector"]["matchLabels"]["app.kubernetes.io/name"] == "web"
        assert len([one for one in made.objects if one["kind"] == "NetworkPolicy"]) == 2
    made = release(text % "ClusterIP")
    assert len([one for one in made.objects if one["kind"] == "NetworkPolicy"]) == 1

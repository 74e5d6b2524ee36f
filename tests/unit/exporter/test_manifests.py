"""The exporter in a release: what it is told, and what it leaves alone."""

from __future__ import annotations

import json
from typing import Any

import attrs
import pytest

from rigel_exporter.config import Config
from rigel_k8s.app.checks.application import check
from rigel_k8s.app.desired import draft
from rigel_k8s.app.generation import Texts
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.release.status import ReleaseStatus, WorkloadStatus
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.rigelfile import Source, merge_options, structure
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.settings import Application

ON = "\nobservability: { enabled: true }\n"
NODES = "image: r:1\nnodes: { talker: { args: [talk.py] }, listener: { args: [hear.py] } }"


def options(text: str) -> OrchestrationOptions:
    node, _ = parse(Source("Rigelfile", text))
    assert node is not None
    found = structure(merge_options(node, None, OrchestrationOptions), OrchestrationOptions)
    assert not found.problems
    assert isinstance(found.draft, OrchestrationOptions)
    return found.draft


def release(text: str, distro: str = "noetic", **more: Any) -> Desired:
    drafted = draft(options(text), ReleaseId("robots", "app"), Application(distro), Texts(), **more)
    return drafted.finish()


def deployments(made: Desired) -> dict[str, Any]:
    return {o["metadata"]["name"]: o for o in made.objects if o["kind"] == "Deployment"}


def configuration(made: Desired) -> dict[str, Any]:
    [found] = [o for o in made.objects if o["metadata"]["name"] == "app-ros-exporter"]
    told = json.loads(found["data"]["config.json"])
    assert set(told) <= set(Config._fields)
    return dict(told)


@pytest.mark.parametrize("distro", ["noetic", "jazzy"])
def test_the_nodes_pods_do_not_change_for_it(distro: str) -> None:
    """Metrics come and go without a robot's restart, a restarted roscore's hash included."""
    plain, watched = deployments(release(NODES, distro)), deployments(release(NODES + ON, distro))
    assert set(watched) - set(plain) == {"ros-exporter"}
    assert all(watched[name] == item for name, item in plain.items())


@pytest.mark.parametrize("how", ["enabled: false", "enabled: true, ros_metrics: false"])
def test_it_is_there_only_where_it_is_wanted(how: str) -> None:
    made = release(f"{NODES}\nobservability: {{ {how} }}")
    assert "ros-exporter" not in deployments(made)


def test_an_empty_release_has_none() -> None:
    assert release("observability: { enabled: true }\ndeploy_ros_master: false").objects == ()


def test_another_configuration_is_another_pod_and_another_roscore_is_not() -> None:
    """It registers by itself with a new roscore, and remembers that there was another."""
    first = deployments(release(NODES + ON))["ros-exporter"]
    image = "\nros_master_image: other:2"
    assert deployments(release(NODES + ON + image))["ros-exporter"] == first
    topics = "\nobservability: { enabled: true, ros_metrics: { topics: [/a] } }"
    second = deployments(release(NODES + topics))["ros-exporter"]
    assert second["spec"]["template"]["metadata"] != first["spec"]["template"]["metadata"]


def test_a_master_that_others_share_tells_its_exporters_apart() -> None:
    """ROS ends the older one of two nodes of a name."""
    elsewhere = f"{NODES}{ON}ros_master_uri: http://robot:11311"
    assert configuration(release(elsewhere))["name"] == "/ros_exporter_robots_app"
    assert configuration(release(elsewhere))["master_uri"] == "http://robot:11311"
    assert "name" not in configuration(release(NODES + ON))


def test_nodes_in_another_domain_are_not_expected() -> None:
    nodes = "image: r:1\nnetwork: { mode: host, domain_id: 4 }\nnodes:\n"
    nodes += "  near: { args: [a.py] }\n  far: { args: [b.py], env: { ROS_DOMAIN_ID: 9 } }"
    told = configuration(release(nodes + ON, "jazzy"))
    assert (told["domain"], told["expected"]) == (4, {"/near": "near"})
    only = nodes.replace("  near: { args: [a.py] }\n", "")
    assert configuration(release(only + ON, "jazzy"))["domain"] == 9


@pytest.mark.parametrize(
    ("network", "told"),
    [
        ("macvlan, interface: eth0, subnet: 10.0.0.0/24", {"interface": "net1"}),
        ("host, interface: wlan0", {"interface": "wlan0"}),
        ("host", {}),
        ("peers", {"mode": "peers", "peers": ["talker-peer", "listener-peer"]}),
        (
            "discovery-server",
            {
                "mode": "discovery-server",
                "servers": ["rigel-k8s-application-discovery-0:11811"],
                "middleware": "fastdds",
            },
        ),
    ],
)
def test_it_finds_participants_as_nodes_do(network: str, told: dict[str, Any]) -> None:
    text = f"{NODES}\nnetwork: {{ mode: {network} }}{ON}"
    chosen = options(text)
    release_id = ReleaseId("robots", str(chosen.deployment_name))
    made = draft(chosen, release_id, Application("jazzy"), Texts())
    [found] = [
        o for o in made.objects if o["metadata"]["name"] == "rigel-k8s-application-ros-exporter"
    ]
    config = json.loads(found["data"]["config.json"])
    ways = ("mode", "interface", "peers", "servers", "middleware")
    assert {k: v for k, v in config.items() if k in ways} == told


def test_a_plain_dds_application_has_no_ros_names_to_expect() -> None:
    made = release(f"{NODES}\nros: none\nnetwork: host{ON}", "jazzy")
    told = configuration(made)
    assert told["ros"] == "none"
    assert "expected" not in told


def test_it_runs_where_all_nodes_are_bound_to() -> None:
    text = "image: r:1\nnodes: { a: { args: [x], placement: { node: robot } } }" + ON
    spec = deployments(release(text))["ros-exporter"]["spec"]["template"]["spec"]
    assert spec["nodeSelector"] == {"kubernetes.io/hostname": "robot"}
    free = text.replace("nodes: {", "nodes: { b: { args: [y] },")
    assert (
        "nodeSelector" not in deployments(release(free))["ros-exporter"]["spec"]["template"]["spec"]
    )


ZENOH = f"{NODES}\nnetwork: zenoh\nrmw_layer: false\n"


@pytest.mark.parametrize(
    ("text", "distro", "word", "severity"),
    [
        (ZENOH + ON, "jazzy", "not zenoh", "warning"),
        (
            ZENOH + "observability: { enabled: true, ros_metrics: true }",
            "jazzy",
            "not zenoh",
            "error",
        ),
        (f"{NODES}\ndeploy_ros_master: false{ON}", "noetic", "needs a ROS master", "warning"),
        (NODES.replace("talker", "ros_exporter") + ON, "noetic", "choose another", "error"),
    ],
)
def test_what_keeps_it_from_seeing_is_told(
    text: str, distro: str, word: str, severity: str
) -> None:
    found = [p for p in check(options(text), distro) if word in p.message]
    assert [p.severity for p in found] == [severity]


def test_what_cannot_be_seen_has_no_exporter() -> None:
    """Notes of processes are seen in every middleware, the discovery of zenoh is not."""
    assert "ros-exporter" not in deployments(release(ZENOH + ON, "jazzy"))
    assert "ros-exporter" in deployments(release(f"{NODES}\nnetwork: zenoh\n" + ON, "jazzy"))


def test_it_reads_the_notes_of_every_node_that_has_the_layer() -> None:
    """On their machines' network, workloads have ports of their own; one without it has none."""
    nodes = "nodes: { a: { args: [x] }, b: { args: [x], rmw_layer: false }, c: { args: [x] } }"
    found = {}
    for mode in ("peers", "host"):
        drafted = draft(
            options(f"{nodes}\nnetwork: {mode}{ON}"),
            ReleaseId("robots", "app"),
            Application("jazzy"),
            Texts(libraries={"rmw-x86_64.so": b""}),
        )
        objects = drafted.finish().objects
        (config,) = (
            o for o in objects if o["metadata"]["name"] == "app-ros-exporter" and "data" in o
        )
        found[mode] = json.loads(config["data"]["config.json"])["keepers"]
        services = {
            f"{o['metadata']['name']}:{o['spec']['ports'][0]['port']}"
            for o in objects
            if o["kind"] == "Service" and o["metadata"]["name"].endswith("-pods")
        }
        assert services == set(found[mode])
    assert found["peers"] == ["a-pods:11399", "c-pods:11399"]
    (a, first), (c, second) = (one.split(":") for one in found["host"])
    assert (a, c) == ("a-pods", "c-pods")
    assert abs(int(first) - int(second)) >= 4


def test_a_static_range_has_an_address_for_it() -> None:
    """Two nodes, a roscore and the exporter want four; the range has three."""
    network = "{ mode: macvlan, interface: eth0, subnet: 10.0.0.0/24, ipam: static,"
    network += " range_start: 10.0.0.1, range_end: 10.0.0.3 }"
    found = [p.message for p in check(options(f"{NODES}\nnetwork: {network}{ON}"), "noetic")]
    assert any("4 pods need one" in message for message in found)


def test_an_image_that_nobody_named_comes_with_its_remedy() -> None:
    """It is in a registry only where somebody put it; a named image is its owner's affair."""
    own = f"{NODES}\nobservability: {{ enabled: true, ros_metrics: {{ image: mine:1 }} }}"
    marks = [deployments(release(text))["ros-exporter"] for text in (NODES + ON, own)]
    told = [item["metadata"]["annotations"].get(REMEDY_ANNOTATION) for item in marks]
    assert "rigel image ros-exporter --push" in told[0]
    assert told[1] is None


def test_status_tells_the_remedy_of_what_is_not_ready() -> None:
    from rigel_k8s.cli.status import reasons_of

    told = {OPTIONAL_ANNOTATION: "true", REMEDY_ANNOTATION: "do that"}
    bad = WorkloadStatus("Deployment", "ros-exporter", 0, 1, False, "0 of 1 ready", (), told)
    good = attrs.evolve(bad, done=True)
    lines = [
        list(reasons_of(ReleaseStatus(ReleaseId("n", "app"), 1, "good", (one,))))
        for one in (bad, good)
    ]
    assert lines == [["ros-exporter: 0 of 1 ready", "ros-exporter: do that"], []]

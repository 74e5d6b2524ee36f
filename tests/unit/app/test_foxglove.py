"""The option `foxglove` is an ordinary node, to which `nodes` may add."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.objects.marks import image_remedy_of
from rigel_k8s.rigelfile import load, preview, realise

from .shapes import container, env, find, options, problems, release

JOB = """\
application: {distro: jazzy}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {image: robot:1, foxglove: {image: "{{ data.image }}"}, nodes: {a: {args: [a]}}}
"""


def test_the_bridge_listens_where_it_is_probed_and_forwarded() -> None:
    """One port for its parameter, its readiness and its Service."""
    made = release("{image: robot:1, network: peers, foxglove: {port: 9000}}", distro="jazzy")
    assert "port: 9000" in find(made, "ConfigMap", "foxglove-parameters")["data"].popitem()[1]
    bridge = container(made, "foxglove")
    assert bridge["ports"] == [{"name": "foxglove", "containerPort": 9000, "protocol": "TCP"}]
    assert bridge["readinessProbe"]["tcpSocket"] == {"port": 9000}
    assert find(made, "Service", "foxglove")["spec"]["ports"][0]["port"] == 9000


@pytest.mark.parametrize("network", ["discovery-server", "{mode: discovery-server}"])
def test_discovery_servers_show_it_all_topics(network: str) -> None:
    """They show others only what these subscribe to."""
    text = f"{{image: robot:1, network: {network}, foxglove: true}}"
    assert env(release(text, distro="jazzy"), "foxglove")["ROS_SUPER_CLIENT"] == "TRUE"
    assert not problems(text, "jazzy")
    without = release("{image: robot:1, network: peers, foxglove: true}", distro="jazzy")
    assert "ROS_SUPER_CLIENT" not in env(without, "foxglove")


@pytest.mark.parametrize("value", ["false", "null"])
def test_without_it_nothing_is_added(value: str) -> None:
    """It may be switched off in its place."""
    assert list(options(f"{{image: robot:1, foxglove: {value}, nodes: {{a: {{}}}}}}").nodes) == [
        "a"
    ]


def test_a_node_of_its_own_is_explained_in_the_same_way() -> None:
    """The hint of a failed roll-out names the package, also for a bridge in `nodes`."""
    text = "nodes: {see: {image: a, package: foxglove_bridge, executable: foxglove_bridge}}"
    remedy = image_remedy_of(find(release(text, distro="humble"), "Deployment", "see"))
    assert remedy == "its image needs the Debian package ros-humble-foxglove-bridge"


def test_an_entry_of_nodes_wins_over_it() -> None:
    """Any option of a node can be set, and a list is replaced."""
    text = "{image: a:1, foxglove: true, nodes: {foxglove: {image: b:1, ports: [8765, 9]}}}"
    (node,) = options(text).nodes.values()
    assert str(node.image) == "b:1"
    assert len(node.ports) == 2
    assert not [problem for problem in problems(text) if problem.severity == "error"]


def test_a_value_that_waits_is_filled_by_a_run(tmp_path: Path) -> None:
    """Before that the bridge is unknown, which is no problem; the revision has the node."""
    (tmp_path / "Rigelfile").write_text(JOB)
    found = load(tmp_path / "Rigelfile")
    seen = preview(found, found.jobs["deploy"], None, None, OrchestrationOptions)
    assert (seen.findings, seen.complete) == ((), False)
    data: dict[str, Any] = {"image": "see:1"}
    real = realise(found, found.jobs["deploy"], None, data, OrchestrationOptions)
    assert str(real.options.nodes["foxglove"].image) == "see:1"
    assert real.raw["nodes"]["foxglove"]["package"] == "foxglove_bridge"
    assert "foxglove" not in real.raw

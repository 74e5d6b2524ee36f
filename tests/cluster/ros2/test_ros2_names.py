"""Names, remappings, parameters and launch files of a Rigelfile arrive at real ROS 2 nodes."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

pytestmark = pytest.mark.cluster

#: A text of digits: what makes a number of it shows, since the talker declares a text.
PARAMETERS = 'nonce: "0042"\nrate: 4.0\n'
LAUNCH = """
<launch>
  <arg name="topic"/>
  <arg name="file"/>
  <node pkg="talker_listener" exec="talker.py" name="launched">
    <param from="$(var file)"/>
    <remap from="chatter" to="$(var topic)"/>
  </node>
  <node pkg="talker_listener" exec="listener.py" name="hears">
    <remap from="chatter" to="$(var topic)"/>
  </node>
</launch>
"""
TOPIC = "/mux/said"
BOTH = {"speaker", "launched"}


def nodes(options: dict[str, Any]) -> None:
    """Have a node by `ros2 run` and two by `ros2 launch`, on pods of their own."""
    files = {"parameter_files": ["config/talker.yaml"]}
    image = options["nodes"]["talker_1"]["image"]
    speaker = {
        "package": "talker_listener",
        "executable": "talker.py",
        "namespace": "/arm",
        "remappings": {"chatter": TOPIC},
        "parameters": {"rate": 5.0},
        **files,
    }
    launch = {
        "package": "talker_listener",
        "file": "both.launch.xml",
        "args": {"topic": TOPIC, "file": "/rigel-k8s-parameters/00-talker.yaml"},
    }
    options["nodes"] = {
        "speaker": {"image": image, **speaker},
        "bringup": {"image": image, "launch": launch, **files},
    }
    options["network"] = {"mode": "peers"}


@pytest.fixture(scope="module")
def named(project: Callable[..., Any], ros2_image: str) -> Any:
    """The talker's image with a launch file more, deployed."""
    made = project("ros2-talker-listener", ros2_image, nodes)
    where = made.rigelfile.parent
    (where / "config").mkdir()
    (where / "config/talker.yaml").write_text(PARAMETERS)
    (where / "talker_listener/launch").mkdir()
    (where / "talker_listener/launch/both.launch.xml").write_text(LAUNCH)
    made("run", "job", "build-talker")
    made("run", "job", "deploy")
    return made


def test_remapped_nodes_hear_each_other_with_their_parameters(named: Any) -> None:
    """The launched listener hears both: what a file says arrives as it is written there."""
    pod = named.pods()["bringup"]["metadata"]["name"]

    def heard() -> dict[str, str]:
        lines = "\n".join(named.cluster.logs(named.space, pod, since_seconds=5))
        return dict(re.findall(r"I heard hello world from (\w+): (\S+) \d+", lines))

    named.until(lambda: heard() == dict.fromkeys(BOTH, "0042"), f"messages, but {heard()},")


def test_names_are_those_that_were_written(named: Any) -> None:
    """A namespace is the node's; a launch file names its own nodes."""

    def ask(*words: str) -> str:
        """What is told by a tool, which may not have discovered all of them when it prints."""
        return str(named("exec", "bringup", "--", "ros2", *words).stdout)

    everybody = {"/arm/speaker", "/launched", "/hears"}
    listing = ("node", "list", "--spin-time", "5")
    named.until(lambda: set(ask(*listing).split()) == everybody, "list of all three nodes")
    ends = "Publisher count: 2\nSubscription count: 1"
    named.until(lambda: ends in ask("topic", "info", TOPIC), ends)


@pytest.mark.parametrize(("node", "rate"), [("/arm/speaker", 5.0), ("/launched", 4.0)])
def test_parameters_win_over_files(named: Any, node: str, rate: float) -> None:
    """`parameters` come last; the launched node has what its file says."""
    told = named("exec", "bringup", "--", "ros2", "param", "get", node, "rate").stdout
    assert told == f"Double value is: {rate}\n"

"""A wrong value in any field of a message or of its stack: nothing is done, the sender hears why.

Each field is tried by itself here. What the errors are is in test_ros1.py, test_ditto.py and
test_symphony.py, and what several wrong values do in test_messages.py.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rigel_k8s.settings import Settings
from rigel_muto.agent.protocols.ros1 import Ros1
from rigel_muto.agent.serving import Dialect
from rigel_muto.agent.wanted import Wanted
from rigel_muto.execution.executor import ReleaseExecutor
from rigel_muto.execution.target import DeployedJob

from . import test_ditto as ditto
from . import test_ros1 as ros1
from . import test_symphony as symphony
from .conftest import IMAGE, Agent
from .recording import Remembering, give
from .test_messages import is_error

DEVICE = "org:r7"
NODE = {
    "name": "talker",
    "namespace": "robot1",
    "pkg": "demo",
    "exec": "talker",
    "args": "a $(arg robot) $(arg other)",
    "output": "screen",
    "respawn": True,
    "respawn_delay": 1,
    "action": "start",
    "if": "true",
    "unless": "0",
    "param": [
        {"name": "rate", "value": "2"},
        {"from": "$(find demo)/a.yaml", "sep": "/"},
        {"name": "model", "command": "xacro a.xacro"},
    ],
    "remap": [{"from": "chatter", "to": "/words"}],
    "env": [{"name": "A", "value": "1"}],
}
COMPOSABLE = {
    "name": "eye",
    "namespace": "robot1",
    "pkg": "car",
    "plugin": "car::Eye",
    "param": [{"name": "rate", "value": "2"}],
    "remap": [{"from": "image", "to": "/image"}],
}
STACK = {
    "name": "all",
    "context": "here",
    "stackId": "org:all",
    "description": "x",
    "title": "x",
    "version": "1",
    "state": "unknown",
    "arg": [{"name": "robot", "value": "r7"}, {"name": "other", "default": "1"}],
    "node": [NODE],
}
ROS1 = {
    **STACK,
    "param": [
        {"name": "map", "value": "a", "namespace": "robot1"},
        {"from": "$(find demo)/b.yaml", "namespace": "robot1"},
        {"name": "description", "command": "cat a"},
    ],
    "stack": [{"thingId": "org:b"}],
}
ROS2 = {
    **STACK,
    "node": [{**NODE, "lifecycle": {"start": ["configure", "activate"], "stop": ["shutdown"]}}],
    "composable": [
        {
            "name": "container",
            "namespace": "robot1",
            "package": "rclcpp_components",
            "executable": "component_container",
            "node": [COMPOSABLE],
        }
    ],
}
PLAIN = {"node": [{"name": "talker", "pkg": "demo", "exec": "talker"}]}
DESCRIBED = {"metadata": {"name": "all", "content_type": "stack/json"}, "launch": PLAIN}
THING = {"thingId": "org:all", "features": {"stack": {"properties": PLAIN}}}
SOLUTION = {
    "metadata": {"name": "all"},
    "spec": {"components": [{"name": "a", "properties": {"type": "stack", "data": PLAIN}}]},
}
#: Keys without a meaning here: Muto's own, and those by which people call a stack.
UNREAD = {"context", "description", "title", "version", "state", "output", "action", "sep"}
UNREAD |= {"respawn", "respawn_delay"}
#: Keys that a value may be missing for, at the end of these paths.
OPTIONAL = {"thingId", "metadata.name", "components.name"}
OPTIONAL |= {"if", "unless", "namespace", "args", "stackId", "env.value", "start", "stop"}


def list_paths(value: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of each value of a stack."""
    if above:
        yield above
    if isinstance(value, dict | list):
        for key, child in value.items() if isinstance(value, dict) else enumerate(value):
            yield from list_paths(child, (*above, key))


def list_wrong(path: tuple[Any, ...], value: Any) -> list[Any]:
    """Return values that this field cannot have; a number is also a text."""
    *above, key = path
    if key in UNREAD:
        return []
    if path == ("name",):
        return [5, [1], {"a": 1}]
    if isinstance(value, list):
        return [5, "x", {"a": 5}, [5]]
    if isinstance(value, dict):
        return [5, "x", [1]] if key in ("lifecycle", "metadata") else [None, 5, "x", [1]]
    if key == "args":
        return [{"a": 1}, [[1]]]
    section = next((word for word in reversed(above) if isinstance(word, str)), "")
    if (section, key) == ("param", "value"):  # may be any value of YAML
        return [None]
    wrong: list[Any] = [[1], {"a": 1}]
    if section == "arg" and key != "name":
        return [*wrong, None]
    return wrong if {key, f"{section}.{key}"} & OPTIONAL else [*wrong, None, ""]


def find(stack: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        stack = stack[key]
    return stack


def replace(stack: Any, path: tuple[Any, ...], value: Any) -> Any:
    changed = copy.deepcopy(stack)
    place = changed
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return changed


START = "stack/commands/start"
TOPIC = f"{DEVICE}/{START}"
TARGET = {"topic": "a", "correlation": "1"}
COMPONENTS = [symphony.component(name, method="apply", action="start") for name in "ab"]
#: By protocol: what hears, the topic, a message, and the paths of fields that it passes over.
MESSAGES: dict[str, tuple[Dialect, str, Any, set[str]]] = {
    "ros1 start": (
        ros1.ROS1,
        f"{ros1.STACKS}/start",
        {"name": "x", "stackId": "org:a", "target": TARGET},
        {"name"},
    ),
    "ros1 kill": (ros1.ROS1, f"{ros1.STACKS}/kill", {"stackId": "org:a", "target": TARGET}, set()),
    **{
        f"ros1 {kind}": (ros1.ROS1, f"{ros1.AGENT}/{kind}", {key: "/a", "target": TARGET}, set())
        for kind, key in (("ros/node/info", "node"), ("ros/topic/info", "topic"))
    },
    "ros1 ros/param/get": (
        ros1.ROS1,
        f"{ros1.AGENT}/ros/param/get",
        {"param": "/a", "target": TARGET},
        set(),
    ),
    "ditto": (
        ditto.DITTO,
        ditto.OWN,
        ditto.write(START, {"stackId": "org:a"}),
        {"headers.content-type", "headers.ditto-originator"},
    ),
    "symphony": (
        symphony.SYMPHONY,
        symphony.REQUESTS,
        symphony.write("POST", None),
        {"contentType", "body"},
    ),
}
#: Symphony drops an answer without its id, and other targets hear the same topic.
UNANSWERED = {"metadata", "metadata.request-id"}


@pytest.mark.parametrize("case", MESSAGES)
def test_a_wrong_value_in_a_message_is_refused(case: str) -> None:
    dialect, topic, message, unread = MESSAGES[case]
    if case == "symphony":
        message = {**message, "body": symphony.pack(symphony.deploy(*COMPONENTS))}
    assert find_carried(dialect, topic, message, unread) == []


def test_a_wrong_value_in_a_body_of_symphony_is_refused() -> None:
    message = symphony.deploy(*COMPONENTS, componentStartIndex=0)
    unread = {"solutionName", "instance", "targets", "assignments", "isInActive", "generation"}
    unread |= {"solution.metadata"}
    unread |= {f"solution.spec.components.{n}.type" for n in (0, 1)}
    unread |= {f"solution.spec.components.{n}.properties.content-type" for n in (0, 1)}
    carried = find_carried(
        symphony.SYMPHONY,
        symphony.REQUESTS,
        message,
        unread,
        lambda body: symphony.write("POST", body, metadata={"request-id": "r-1"}),
    )
    assert carried == []


def find_carried(
    dialect: Dialect,
    topic: str,
    message: Any,
    unread: set[str],
    wrap: Callable[[Any], Any] = lambda message: message,
) -> list[tuple[str, Any]]:
    """Return the fields, each with a wrong value, of messages that are carried out."""
    carried, executor = [], Remembering()
    give(dialect, executor, topic, wrap(message), response_topic="answers")
    assert len(executor.commands) + len(executor.queries) == 1, "as it is nothing is wrong with it"
    for path in list_paths(message):
        name = ".".join(map(str, path))
        if any(name == one or name.startswith(f"{one}.") for one in unread):
            continue
        for value in list_other_kinds(find(message, path)):
            executor, wrong = Remembering(), wrap(replace(message, path, value))
            answers = give(dialect, executor, topic, wrong, response_topic="answers")
            refused = [is_error(answer) for _, answer in answers] or [name in UNANSWERED]
            if executor.commands or executor.queries or not all(refused):
                carried.append((name, value))
    return carried


def list_other_kinds(value: Any) -> list[Any]:
    """Return values of other kinds than a field of a message has."""
    kinds: list[Any] = [0, 5, True, False, "", "x", [], [1], {}, {"a": 1}, "\ud800"]
    other = [one for one in kinds if type(one) is not type(value)]
    return [*other, "\ud800"] if isinstance(value, str) else other


def start(agent: Agent, distro: str) -> ReleaseExecutor:
    job = {"namespace": "n", "deployment_name": "robot", "image": IMAGE}
    job |= {"ros_master_uri": "http://robot:11311"} if distro == "noetic" else {"network": "host"}
    deploy = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}
    text = json.dumps({"application": {"distro": distro}, "jobs": {"deploy": deploy}})
    (agent.directory / "Rigelfile").write_text(text)
    return agent.run()


@pytest.mark.parametrize(
    ("distro", "stack"),
    [
        pytest.param("noetic", ROS1, id="ros1"),
        pytest.param("jazzy", ROS2, id="ros2"),
        pytest.param("noetic", DESCRIBED, id="described"),
        pytest.param("noetic", THING, id="thing"),
        pytest.param("noetic", SOLUTION, id="solution"),
    ],
)
def test_a_wrong_value_in_any_field_is_refused(agent: Agent, distro: str, stack: Any) -> None:
    executor = start(agent, distro)
    tried, carried = 0, []
    for path in list_paths(stack):
        for value in list_wrong(path, find(stack, path)):
            changed = replace(stack, path, value)
            [(_, answered)] = give(Ros1(DEVICE), executor, TOPIC, changed, response_topic="answers")
            tried += 1
            if answered.get("status") != "EXCEPTION" or not answered["error"]:
                carried.append((path, value, answered))
    assert carried == []
    assert tried > 10
    assert agent.nodes == set()
    assert agent.states == [("", "idle")]
    application = DeployedJob(Settings(rigelfile=agent.directory / "Rigelfile"), agent.report)
    application.prepare(Wanted(stack=json.dumps(stack)))  # as it is nothing is wrong with it

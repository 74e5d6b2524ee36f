"""Commands of Muto's ROS 1 generation: what each message does, and what its sender hears."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_muto.agent.commands import Arrival, Deploy, Kill, Message, Outcome, Query, Stage
from rigel_muto.agent.payloads import MOST_BYTES
from rigel_muto.agent.protocols.ros1 import Ros1

from .recording import NODE, STACK, Remembering, give

THING = "org.example.robots:r7"
ROS1 = Ros1(THING)
STACKS, AGENT = f"{THING}/stack/commands", f"{THING}/agent/commands"


@pytest.mark.parametrize(
    ("method", "payload", "command"),
    [
        ("start", {"name": "t", "stackId": "org:t"}, Deploy(stack_id="org:t")),
        ("apply", {"stackId": "org:t"}, Deploy(stack_id="org:t")),
        ("start", STACK, Deploy(stack=json.dumps(STACK))),
        (
            "start",
            {**STACK, "stackId": "a:b"},
            Deploy(stack=json.dumps({**STACK, "stackId": "a:b"}), stack_id="a:b"),
        ),
        ("apply", {"stackId": "a:b", "node": [], "param": []}, Deploy(stack_id="a:b")),
        ("kill", {"stackId": "org:t"}, Kill(stack_id="org:t")),
        ("kill", {}, Kill()),
        ("kill", b"", Kill()),
    ],
)
def test_a_command_is_what_its_topic_says(method: str, payload: object, command: object) -> None:
    """A whole stack is what runs, even if it has an id; one that only has an id is looked up."""
    executor = Remembering()
    answers = give(ROS1, executor, f"{STACKS}/{method}", payload, response_topic="answers")
    assert executor.commands == [command]
    [(topic, value)] = answers
    assert topic == "answers"
    assert (value["result"], value["command"]) == ("success", f"{STACKS}/{method}")


def test_the_dashboards_target_is_no_part_of_the_stack() -> None:
    """It says where the answer goes if MQTT's properties do not."""
    executor = Remembering()
    payload = {**STACK, "target": {"topic": "db/1", "correlation": "c1"}}
    [(topic, _)] = give(ROS1, executor, f"{STACKS}/start", payload)
    assert topic == "db/1"
    assert [json.loads(command.stack or "") for command in executor.commands] == [STACK]  # type: ignore[union-attr]


def test_what_happened_is_told_truthfully() -> None:
    """Muto answers success whatever happens."""
    executor = Remembering(lambda _: Outcome(Stage.REFUSED, "the image is not allowed"))
    [(_, value)] = give(ROS1, executor, f"{STACKS}/start", STACK, response_topic="answers")
    assert value == {"status": "EXCEPTION", "error": "the image is not allowed"}


def test_the_correlation_comes_back_and_tells_duplicates() -> None:
    """Equal messages with one correlation are duplicates; others with it are not."""
    seen = []
    for payload in (STACK, STACK, {"stackId": "org:t"}):
        arrival = Arrival(
            topic=f"{STACKS}/start",
            payload=json.dumps(payload).encode(),
            response_topic="answers",
            correlation=b"\xff1",
        )
        request = ROS1.read(arrival)
        assert isinstance(request.asks, Deploy)
        seen.append(request.asks.identity)
        [message] = request.answer(Outcome(Stage.ACCEPTED))
        assert isinstance(message, Message)
        assert message.correlation == b"\xff1"
    assert seen[0] == seen[1] != seen[2]


def test_without_a_correlation_nothing_is_a_duplicate() -> None:
    request = ROS1.read(Arrival(topic=f"{STACKS}/start", payload=b'{"stackId": "org:t"}'))
    assert request.asks == Deploy(stack_id="org:t", identity="")


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("ping", {}),
        ("ros/node", {}),
        ("ros/node/info", {"node": "/talker"}),
        ("ros/topic", {}),
        ("ros/topic/info", {"topic": "/chatter"}),
        ("ros/topic/echo", {"topic": "/chatter", "action": "start", "rate": "1000"}),
        ("ros/param", {}),
        ("ros/param/get", {"param": "/rate"}),
    ],
)
def test_a_query_is_answered_where_its_payload_wants_it(
    kind: str, arguments: dict[str, Any]
) -> None:
    """With a first answer to MQTT's response topic, as Muto has it."""
    executor = Remembering()
    payload = {**arguments, "target": {"topic": "db/1"}}
    answers = give(ROS1, executor, f"{AGENT}/{kind}", payload, response_topic="answers")
    assert executor.queries == [Query(kind, arguments)]  # type: ignore[arg-type]
    assert answers == [("answers", {"status": "Started"}), ("db/1", {"asked": kind})]


def test_a_query_with_one_place_for_answers_gets_one() -> None:
    executor = Remembering()
    only = give(ROS1, executor, f"{AGENT}/ros/node", {}, response_topic="answers")
    assert only == [("answers", {"asked": "ros/node"})]
    only = give(ROS1, executor, f"{AGENT}/ros/node", {"target": {"topic": "db/1"}})
    assert only == [("db/1", {"asked": "ros/node"})]


def test_other_topics_of_the_device_are_answered_with_none() -> None:
    executor = Remembering()
    answers = give(ROS1, executor, f"{THING}/telemetry/x", b"\xff", response_topic="answers")
    assert answers == [("answers", None)]
    assert give(ROS1, executor, "org.example.robots:r70/stack/commands/kill", b"{}") == []
    assert not executor.commands


@pytest.mark.parametrize(
    ("topic", "payload", "error"),
    [
        (f"{STACKS}/start", b"{", "is not JSON"),
        (f"{STACKS}/start", b"\xff\xfe", "is not JSON"),
        (f"{STACKS}/start", b"[1]", "must be an object"),
        (f"{STACKS}/start", b'{"stackId": "a", "stackId": "b"}', "same key twice"),
        (f"{STACKS}/start", b'{"node": NaN}', "is not a number"),
        (f"{STACKS}/start", b'{"node": 1e999}', "is not JSON"),
        (f"{STACKS}/start", b"[" * 200_000, "is not JSON"),
        (f"{STACKS}/start", b'{"a":' * 500 + b"1" + b"}" * 500, "nested more than"),
        (f"{STACKS}/start", b"{" + b" " * MOST_BYTES + b"}", "more than"),
        (f"{STACKS}/start", {"stackId": 7}, '"stackId" must be text'),
        (f"{STACKS}/start", b'{"stackId": "\\ud800"}', "half a character"),
        (f"{STACKS}/start", {}, "not a stack"),
        (f"{STACKS}/start", {"name": "t"}, "not a stack"),
        (f"{STACKS}/start", {"stackId": "a:b", "noed": [NODE]}, "not a stack"),
        (f"{STACKS}/start", [STACK, STACK], "must be an object"),
        (f"{STACKS}/start", {"items": [STACK, STACK]}, "several stacks"),
        (f"{STACKS}/start", {"artifact": {"type": "archive"}}, "an archive"),
        (f"{STACKS}/restart", STACK, 'unknown command "restart"'),
        (f"{STACKS}/", STACK, "unknown command"),
        (f"{STACKS}/start/now", STACK, "unknown command"),
        (f"{STACKS}/start", {**STACK, "target": "db"}, '"target" must be an object'),
        (f"{STACKS}/start", {**STACK, "target": {"topic": "a/#"}}, "no answer can be published"),
        (f"{STACKS}/start", {**STACK, "target": {"topic": "$SYS/a"}}, "no answer can be"),
        (f"{AGENT}/ros/node", b"x", "is not JSON"),
        (f"{AGENT}/foo/bar", {}, 'unknown command "foo/bar"'),
        (f"{AGENT}/ros/node/info", {}, 'needs "node"'),
        (f"{AGENT}/ros/topic/info", {"topic": ""}, 'needs "topic"'),
        (f"{AGENT}/ros/topic/echo", {}, 'needs "topic"'),
    ],
)
def test_what_is_wrong_is_answered_and_nothing_else_happens(
    topic: str, payload: object, error: str
) -> None:
    executor = Remembering()
    [(place, value)] = give(ROS1, executor, topic, payload, response_topic="answers")
    assert (place, value["status"]) == ("answers", "EXCEPTION")
    assert error in value["error"]
    assert give(ROS1, executor, topic, payload) == []
    assert not executor.commands
    assert not executor.queries


@pytest.mark.parametrize("topic", ["", "a/+", "a/#", "$SYS/x", "a\0b", "a" * 65536])
def test_nothing_is_published_on_a_topic_that_is_none(topic: str) -> None:
    """The command itself is carried out."""
    executor = Remembering()
    assert give(ROS1, executor, f"{STACKS}/kill", b"", response_topic=topic) == []
    assert executor.commands == [Kill()]

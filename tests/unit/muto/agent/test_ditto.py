"""Commands of Muto's ROS 2 generation: live messages in Ditto's protocol."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_muto.agent.commands import Arrival, Deploy, Kill, Outcome, Query, Stage
from rigel_muto.agent.protocols.ditto import Ditto

from .recording import STACK, Remembering, give

#: A name in which Muto, which looks for such words, finds a command.
THING = "org.example:ping-stack-agent-telemetry"
DITTO = Ditto(THING)
OWN = f"muto/{THING}"
CHANNEL = "org.example/ping-stack-agent-telemetry/things"
REMOVED = object()


def write(subject: str, value: Any = None, **changed: Any) -> dict[str, Any]:
    """Return a live message; `headers_...` changes a header, REMOVED leaves a key out."""
    headers: dict[str, Any] = {
        "content-type": "application/json",
        "reply-to": "answers",
        "correlation-id": "c1",
        "response-required": True,
        "ditto-originator": "nginx:ditto",
    }
    message: dict[str, Any] = {
        "topic": f"{CHANNEL}/live/messages/{subject}",
        "headers": headers,
        "path": f"/inbox/messages/{subject}",
        "value": value,
    }
    for key, new in changed.items():
        name = key.removeprefix("headers_").replace("_", "-")
        place = headers if key.startswith("headers_") else message
        if new is REMOVED:
            del place[name]
        else:
            place[name] = new
    return message


@pytest.mark.parametrize(
    ("subject", "value", "command"),
    [
        ("stack/commands/start", STACK, Deploy(stack=json.dumps(STACK))),
        ("stack/commands/apply", {"stackId": "org:t"}, Deploy(stack_id="org:t")),
        ("stack/commands/kill", {"stackId": "org:t"}, Kill(stack_id="org:t")),
        ("stack/commands/kill", None, Kill()),
    ],
)
def test_a_commands_stack_is_its_value(subject: str, value: Any, command: object) -> None:
    """The answer is the same message on its way back."""
    executor = Remembering()
    message = write(subject, value, headers_correlation_id=REMOVED)
    [(topic, answer)] = give(DITTO, executor, OWN, message)
    assert executor.commands == [command]
    assert topic == "answers"
    assert answer == {
        **message,
        "path": f"/outbox/messages/{subject}",
        "value": {"result": "success", "state": "accepted", "message": "stored"},
    }


@pytest.mark.parametrize("value", [None, 0, "x", [1], {"a": {"b": None}}])
def test_a_ping_comes_back_as_it_is(value: Any) -> None:
    [(topic, answer)] = give(DITTO, Remembering(), OWN, write("agent/commands/ping", value))
    assert (topic, answer["value"]) == ("answers", value)
    assert answer["path"] == "/outbox/messages/agent/commands/ping"


def test_a_query_is_answered() -> None:
    executor = Remembering()
    message = write("agent/commands/ros/topic/info", {"topic": "/chatter"})
    [(_, answer)] = give(DITTO, executor, OWN, message)
    assert executor.queries == [Query("ros/topic/info", {"topic": "/chatter"})]
    assert answer["value"] == {"asked": "ros/topic/info"}


def test_the_correlation_is_mqtts_too() -> None:
    payload = json.dumps(write("stack/commands/kill")).encode()
    request = DITTO.read(Arrival(topic=OWN, payload=payload))
    assert request
    assert isinstance(request.asks, Kill)
    assert request.asks.identity.startswith("c1:")
    for outcome in (Outcome(Stage.ACCEPTED), Outcome(Stage.FAILED, "why")):
        [message] = request.answer(outcome)
        assert message.correlation == b"c1"
        assert json.loads(message.payload)["headers"]["correlation-id"] == "c1"


@pytest.mark.parametrize(
    "message",
    [
        write("stack/commands/start", STACK, path="/outbox/messages/stack/commands/start"),
        write("stack/commands/start", path="/outbox", topic="nonsense"),
        write("", topic=f"{CHANNEL}/twin/errors", path="/", value={"status": 400}),
        write("", topic="org.other/thing/things/twin/errors", path="/"),
    ],
)
def test_answers_and_errors_are_not_answered(message: dict[str, Any]) -> None:
    """Else two agents on one topic would never stop."""
    executor = Remembering()
    assert give(DITTO, executor, OWN, message) == []
    assert not executor.commands


@pytest.mark.parametrize("required", [False, "false"])
def test_who_wants_no_answer_gets_only_errors(required: object) -> None:
    executor = Remembering()
    fine = write("stack/commands/kill", headers_response_required=required)
    assert give(DITTO, executor, OWN, fine) == []
    wrong = write("stack/commands/dance", headers_response_required=required)
    assert [topic for topic, _ in give(DITTO, executor, OWN, wrong)] == ["answers"]
    assert len(executor.commands) == 1


def test_a_command_without_a_way_back_is_carried_out() -> None:
    executor = Remembering()
    message = write("stack/commands/kill", headers=REMOVED)
    assert give(DITTO, executor, OWN, message) == []
    assert executor.commands == [Kill()]


MALFORMED, UNSUPPORTED = "things:topic.malformed", "things:ditto.unsupported"
START = "stack/commands/start"


@pytest.mark.parametrize(
    ("message", "name", "error", "place"),
    [
        (b"{", MALFORMED, "is not JSON", OWN),
        (b"[]", MALFORMED, "must be an object", OWN),
        (b"", MALFORMED, '"topic" must be', OWN),
        (write(START, STACK, topic=REMOVED), MALFORMED, '"topic" must be', "answers"),
        (write(START, STACK, topic="a/b/c"), MALFORMED, '"topic" must be', "answers"),
        (
            write(START, STACK, topic=f"org/other/things/live/messages/{START}"),
            UNSUPPORTED,
            "another thing",
            "answers",
        ),
        (
            write(START, STACK, topic=f"{CHANNEL}/twin/commands/modify"),
            UNSUPPORTED,
            "not supported",
            "answers",
        ),
        (
            write(START, STACK, topic=f"{CHANNEL}/live/events/{START}"),
            UNSUPPORTED,
            "not supported",
            "answers",
        ),
        (write("telemetry/commands/start", STACK), UNSUPPORTED, "not supported", "answers"),
        (write("stack/start", STACK), UNSUPPORTED, "not supported", "answers"),
        (write("stack/commands/restart", STACK), UNSUPPORTED, "unknown command", "answers"),
        (write("agent/commands/foo", {}), UNSUPPORTED, "unknown command", "answers"),
        (write(START, STACK, path=REMOVED), MALFORMED, '"path" must', "answers"),
        (write(START, STACK, path="/features"), MALFORMED, '"path" must', "answers"),
        (write(START, STACK, headers=[1]), MALFORMED, '"headers" must', OWN),
        (write(START, STACK, headers_reply_to=5), MALFORMED, '"reply-to" must', OWN),
        (write(START, STACK, headers_reply_to="a/+"), MALFORMED, "no answer can", OWN),
        (write(START), UNSUPPORTED, "not a stack", "answers"),
        (write(START, {"artifact": {"data": "x"}}), UNSUPPORTED, "archive", "answers"),
        (write("agent/commands/ros/param/get", {}), MALFORMED, 'needs "param"', "answers"),
    ],
)
def test_what_is_wrong_becomes_an_error_of_ditto(
    message: object, name: str, error: str, place: str
) -> None:
    """At the sender, or where Muto reports it; nothing else happens."""
    executor = Remembering()
    [(topic, value)] = give(DITTO, executor, OWN, message)
    assert (topic, value["topic"], value["path"]) == (place, f"{CHANNEL}/twin/errors", "/")
    assert (value["status"], value["value"]["status"]) == (400, 400)
    assert (value["value"]["error"], error in value["value"]["message"]) == (name, True)
    assert not executor.commands
    assert not executor.queries
    assert give(DITTO, executor, OWN, value) == [], "an error must not be answered"


def test_only_the_devices_own_topic_is_heard() -> None:
    assert DITTO.topic == OWN
    assert Ditto(THING, "fleet/a").hears(f"fleet/a/{THING}")
    assert not DITTO.hears(f"{OWN}/more")

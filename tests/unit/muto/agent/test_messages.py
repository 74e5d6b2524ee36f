"""Messages with anything wrong in them, and executors that fail: the agent goes on."""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_muto.agent.broker import Delivery
from rigel_muto.agent.commands import Arrival, Command, Outcome, Unavailable
from rigel_muto.agent.payloads import is_topic
from rigel_muto.agent.serving import Dialect, answer
from tests.support.recorder import Recorder

from ..test_mutations import mutate
from . import test_ditto as ditto
from . import test_ros1 as ros1
from . import test_symphony as symphony
from .recording import STACK, Remembering

WRONG = [b"", b"null", b"\xff", b"\x00", b"[" * 5000, b'"' + b"x" * 70_000 + b'"', b"1e999", b"-"]
ROUNDS = 300


def mutate_symphony(chance: random.Random) -> Any:
    """Return a request whose body, or whose envelope, is not as Symphony writes it."""
    method = chance.choice(("GET", "POST", "DELETE"))
    deployment = symphony.deploy(symphony.component("a"), symphony.component("b", data=STACK))
    if chance.random() < 0.7:
        return symphony.write(method, mutate(deployment, chance))
    return mutate(symphony.write(method, deployment), chance)


def mutate_ditto(chance: random.Random) -> Any:
    subject = chance.choice(("stack/commands/start", "agent/commands/ros/topic/info"))
    return mutate(ditto.write(subject, {**STACK, "topic": "/chatter"}), chance)


def mutate_ros1(chance: random.Random) -> Any:
    return mutate({**STACK, "topic": "/a", "target": {"topic": "a", "correlation": "1"}}, chance)


CASES: dict[str, tuple[Dialect, tuple[str, ...], Callable[[random.Random], Any]]] = {
    "ros1": (ros1.ROS1, (f"{ros1.STACKS}/apply", f"{ros1.AGENT}/ros/topic/info"), mutate_ros1),
    "ditto": (ditto.DITTO, (ditto.OWN,), mutate_ditto),
    "symphony": (symphony.SYMPHONY, (symphony.REQUESTS,), mutate_symphony),
}


def write_payloads(make: Callable[[random.Random], Any], chance: random.Random) -> Iterator[bytes]:
    """Yield payloads that are JSON, that are damaged, and that are anything."""
    yield from WRONG
    for _ in range(ROUNDS):
        payload = json.dumps(make(chance)).encode()
        yield payload
        place = chance.randrange(len(payload))
        yield payload[:place] + bytes([chance.randrange(256)]) + payload[place + 1 :]
        yield payload[:place]


def is_error(value: Any) -> bool:
    """Return whether an answer says that nothing was done."""
    state = value.get("state")
    return value.get("status") in ("EXCEPTION", 400) or (isinstance(state, int) and state != 200)


@pytest.mark.parametrize("protocol", CASES)
def test_a_damaged_message_is_carried_out_or_refused(protocol: str) -> None:
    """Not both, and without a defect of the agent; each answer can be published."""
    dialect, topics, make = CASES[protocol]
    chance = random.Random(protocol)
    done = refused = 0
    for payload in write_payloads(make, chance):
        arrival = Arrival(topic=chance.choice(topics), payload=payload, response_topic="answers")
        executor, reporter = Remembering(), Recorder()
        answers = answer(Delivery(arrival=arrival), [dialect], executor, reporter)
        assert not reporter.texts, (payload, reporter.texts)
        assert all(is_topic(message.topic) for message in answers)
        failed = any(is_error(json.loads(message.payload)) for message in answers)
        assert not (failed and (executor.commands or executor.queries)), payload
        done += bool(executor.commands)
        refused += failed
    assert done > 10
    assert refused > 10


def submit(fail: Callable[[Command], Outcome], *, kept: bool) -> tuple[list[Any], list[str]]:
    """Return the answers to a command that fails, and what is reported."""
    reporter = Recorder()
    arrival = Arrival(topic=f"{ros1.STACKS}/kill", payload=b"", response_topic="answers")
    delivery = Delivery(arrival=arrival, kept=kept)
    answers = answer(delivery, [ros1.ROS1], Remembering(fail), reporter)
    return [json.loads(message.payload) for message in answers], reporter.texts


def raising(error: BaseException) -> Callable[[Command], Outcome]:
    def fail(_: Command) -> Outcome:
        raise error

    return fail


@pytest.mark.parametrize("kept", [True, False])
def test_what_fails_is_told_to_the_sender(*, kept: bool) -> None:
    answers, words = submit(raising(RigelK8sError("no such stack")), kept=kept)
    assert answers == [{"status": "EXCEPTION", "error": "no such stack"}]
    assert not words


def test_a_defect_is_told_and_kept_in_the_log() -> None:
    answers, [words] = submit(raising(ZeroDivisionError("by zero")), kept=True)
    assert answers == [
        {"status": "EXCEPTION", "error": "the agent failed: ZeroDivisionError: by zero"}
    ]
    assert "Traceback" in words


def test_what_cannot_be_stored_now_stays_with_the_broker() -> None:
    """A message that the broker does not keep is answered, so that its sender knows."""
    with pytest.raises(Unavailable):
        submit(raising(Unavailable("the cluster is away")), kept=True)
    answers, _ = submit(raising(Unavailable("the cluster is away")), kept=False)
    assert answers == [{"status": "EXCEPTION", "error": "the cluster is away"}]


def test_an_agent_that_ends_answers_nothing() -> None:
    """The message comes again when it is back."""
    with pytest.raises(Interrupted):
        submit(raising(Interrupted("stop")), kept=True)


def test_an_answer_that_is_no_json_does_not_end_the_agent() -> None:
    class Odd(Remembering):
        def ask(self, query: object) -> Any:
            return {"x": {1, 2}}

    reporter = Recorder()
    arrival = Arrival(topic=f"{ros1.AGENT}/ros/node", payload=b"", response_topic="answers")
    assert answer(Delivery(arrival=arrival), [ros1.ROS1], Odd(), reporter) == ()
    assert "cannot be answered" in reporter.texts[0]

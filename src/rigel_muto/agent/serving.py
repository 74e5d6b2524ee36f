"""From messages to commands to answers, one message after the other."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Sequence
from typing import TypeAlias

from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.report import Reporter
from rigel_muto.agent.broker import Broker, Delivery
from rigel_muto.agent.commands import (
    Asks,
    Executor,
    Inventory,
    Message,
    Outcome,
    Query,
    Refusal,
    Reply,
    Result,
    Stage,
    States,
    Unavailable,
)
from rigel_muto.agent.protocols.ditto import Ditto
from rigel_muto.agent.protocols.ros1 import Ros1
from rigel_muto.agent.protocols.symphony import Symphony

#: A protocol, for one device: it has a topic, hears others, and reads a request of a message.
Dialect: TypeAlias = Ros1 | Ditto | Symphony

#: Seconds between two checks whether the agent must end.
POLL = 0.5
#: Seconds before a command that could not be stored is submitted again: at first, and at most.
FIRST, LONGEST = 0.5, 30.0


def serve(
    broker: Broker,
    dialects: Sequence[Dialect],
    executor: Executor,
    reporter: Reporter,
    ending: threading.Event,
) -> None:
    """Carry out what the broker delivers until `ending` is set.

    A message is acknowledged after its answers are published: if the agent is killed earlier, it
    receives the message again.
    """
    while not ending.is_set():
        delivery = broker.next(POLL)
        if delivery is None:
            continue
        answers = _insist(delivery, dialects, executor, reporter, ending)
        if answers is None:
            return
        for message in answers:
            broker.publish(message)
        broker.acknowledge(delivery)


def _insist(
    delivery: Delivery,
    dialects: Sequence[Dialect],
    executor: Executor,
    reporter: Reporter,
    ending: threading.Event,
) -> tuple[Message, ...] | None:
    """Return the answers to a message; None if the agent ends before its command is stored."""
    delay = FIRST
    while True:
        try:
            return answer(delivery, dialects, executor, reporter)
        except Unavailable as error:
            if delay == FIRST:
                reporter.warn(f"{error.message}; trying again")
        if ending.wait(delay):
            return None
        delay = min(2 * delay, LONGEST)


def answer(
    delivery: Delivery, dialects: Sequence[Dialect], executor: Executor, reporter: Reporter
) -> tuple[Message, ...]:
    """Return the answers to a message after doing what it requests.

    A failure of one message is reported, to its sender too, and does not end the agent.

    Raises:
        Unavailable: a command that the broker keeps cannot be stored now.
        Interrupted: the agent ends.
    """
    topic = delivery.arrival.topic
    try:
        dialect = next((one for one in dialects if one.hears(topic)), None)
        request = dialect.read(delivery.arrival) if dialect else None
        if request is None:
            return ()
        return request.answer(_try(request.asks, executor, reporter, kept=delivery.kept))
    except (Interrupted, Unavailable):
        raise
    except Exception:
        reporter.warn(f"a message on {topic} cannot be answered: {traceback.format_exc()}")
        return ()


def _try(asks: Asks, executor: Executor, reporter: Reporter, *, kept: bool) -> Reply:
    """Return the result of a request; an error is a failure of this request."""
    try:
        return _carry_out(asks, executor)
    except Interrupted:
        raise
    except Unavailable as error:
        if kept:
            raise
        return Outcome(Stage.FAILED, error.message)
    except RigelK8sError as error:
        return Outcome(Stage.FAILED, error.message)
    except Exception as error:
        reporter.warn(f"a command failed: {traceback.format_exc()}")
        return Outcome(Stage.FAILED, f"the agent failed: {type(error).__name__}: {error}")


def _carry_out(asks: Asks, executor: Executor) -> Reply:
    if isinstance(asks, Refusal):
        return Outcome(Stage.REFUSED, asks.message)
    if isinstance(asks, Query):
        return Result(executor.ask(asks))
    if isinstance(asks, Inventory):
        return States(executor.look(asks.components))
    return executor.submit(asks)

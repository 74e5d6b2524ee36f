"""The loop: a message is acknowledged when all that it asks for has happened."""

from __future__ import annotations

import threading
from typing import Any

from rigel_muto.agent.broker import Delivery
from rigel_muto.agent.commands import Arrival, Message
from rigel_muto.agent.protocols.ros1 import Ros1
from rigel_muto.agent.serving import serve
from tests.support.recorder import Recorder

from .recording import Remembering

COMMAND = Arrival(
    topic="org:robot/stack/commands/start", payload=b'{"stackId": "org:a"}', response_topic="back"
)


class OneMessage:
    """A broker that delivers one message, and notes what is done with it."""

    def __init__(self) -> None:
        self.ending = threading.Event()
        self.done: list[str] = []

    def next(self, seconds: float) -> Delivery | None:
        return Delivery(arrival=COMMAND, number=1, kept=True)

    def publish(self, message: Message) -> None:
        self.done.append(f"answer on {message.topic}")

    def acknowledge(self, delivery: Delivery) -> None:
        self.done.append("acknowledged")
        self.ending.set()


def test_a_message_is_acknowledged_after_its_answers() -> None:
    """An agent that is killed in between gets it again, and answers again."""
    broker: Any = OneMessage()
    executor = Remembering()
    serve(broker, [Ros1("org:robot")], executor, Recorder(), broker.ending)
    assert len(executor.commands) == 1
    assert broker.done == ["answer on back", "acknowledged"]

"""An agent that serves, on a real broker and with an executor that only remembers."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import attrs

from rigel_muto.agent.address import Address, Login
from rigel_muto.agent.broker import Broker
from rigel_muto.agent.commands import Deploy
from rigel_muto.agent.protocols.ditto import Ditto
from rigel_muto.agent.protocols.ros1 import Ros1
from rigel_muto.agent.protocols.symphony import Symphony
from rigel_muto.agent.serving import Dialect, serve
from tests.support.recorder import Recorder
from tests.support.until import until

from . import test_ditto as ditto
from .recording import Remembering

THING = "org.example:r7"
START = f"{THING}/stack/commands/start"
DIALECTS: Sequence[Dialect] = (
    Ros1(THING),
    Ditto(ditto.THING),
    Symphony("robot-7", "fleet"),
)


@attrs.frozen
class Agent:
    """A running agent."""

    broker: Broker
    executor: Remembering
    reporter: Recorder

    def wait_for(self, count: int) -> list[str]:
        """Return the ids of the stacks that were started, once there are so many commands."""
        until(lambda: len(self.executor.commands) >= count, f"{count} commands", every=0.02)
        return [c.stack_id for c in self.executor.commands if isinstance(c, Deploy)]


def connect(
    port: int, reporter: Recorder, login: Login | None = None, *, tls: bool = False
) -> Broker:
    address = Address("127.0.0.1", port, tls)
    topics = [dialect.topic for dialect in DIALECTS]
    return Broker(address, login or Login(), "rigel-r7", topics, reporter)


@contextmanager
def agent(
    port: int,
    executor: Remembering | None = None,
    login: Login | None = None,
    *,
    tls: bool = False,
    waiting: bool = True,
) -> Iterator[Agent]:
    """An agent that serves until the end of the block; `waiting` for its connection first."""
    reporter, ending = Recorder(), threading.Event()
    doing = executor or Remembering()
    with connect(port, reporter, login, tls=tls) as broker:
        words = (broker, DIALECTS, doing, reporter, ending)
        thread = threading.Thread(target=serve, args=words, daemon=True)
        thread.start()
        if waiting:
            wait_until_ready(broker, reporter)
        yield Agent(broker, doing, reporter)
        ending.set()
        thread.join(30)


def wait_until_ready(broker: Broker, reporter: Recorder) -> None:
    until(lambda: broker.is_ready, "connection", every=0.02, last_words=lambda: reporter.texts)

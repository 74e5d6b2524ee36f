"""An executor that only remembers: the real one has tests of its own."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from rigel_muto.agent.broker import Delivery
from rigel_muto.agent.commands import (
    Arrival,
    Command,
    ComponentState,
    Executor,
    Message,
    Outcome,
    Query,
    Stage,
)
from rigel_muto.agent.serving import Dialect, answer
from tests.support.recorder import Recorder

NODE = {"name": "talker", "pkg": "demo", "exec": "talker"}
STACK = {"name": "talking", "node": [NODE]}


class Remembering:
    """Accepts each command, as `decide` says if it is set.

    Attributes:
        states: what there is of Symphony's components.
    """

    def __init__(self, decide: Callable[[Command], Outcome] | None = None) -> None:
        self.commands: list[Command] = []
        self.queries: list[Query] = []
        self.states: dict[str, ComponentState] = {}
        self._decide = decide

    def submit(self, command: Command) -> Outcome:
        self.commands.append(command)
        return self._decide(command) if self._decide else Outcome(Stage.ACCEPTED, "stored")

    def look(self, components: tuple[str, ...]) -> Mapping[str, ComponentState]:
        return {name: self.states[name] for name in components if name in self.states}

    def ask(self, query: Query) -> Any:
        self.queries.append(query)
        return {"asked": query.kind}


def give(
    dialect: Dialect,
    executor: Executor,
    topic: str,
    payload: object,
    reporter: Recorder | None = None,
    **properties: Any,
) -> list[tuple[str, Any]]:
    """Return topics and values of the answers to a message; what is not bytes is sent as JSON."""
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    arrival = Arrival(topic=topic, payload=data, **properties)
    recorder = reporter or Recorder()
    answers = answer(Delivery(arrival=arrival), [dialect], executor, recorder)
    assert reporter or not recorder.texts, recorder.texts
    return [(message.topic, _read(message)) for message in answers]


def _read(message: Message) -> Any:
    return None if message.payload == b"None" else json.loads(message.payload)

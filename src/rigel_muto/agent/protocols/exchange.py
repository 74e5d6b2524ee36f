"""What all protocols have in common: what arrives, and what can be answered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, TypeAlias

import attrs

from rigel_muto.agent.commands import (
    Command,
    ComponentState,
    Inventory,
    Message,
    Outcome,
    Query,
    Refusal,
)


@attrs.frozen(kw_only=True)
class Arrival:
    """A message as it came, with MQTT 5's ResponseTopic and CorrelationData if it had them."""

    topic: str
    payload: bytes
    response_topic: str | None = None
    correlation: bytes | None = None


@attrs.frozen
class Result:
    """The answer to a query, a JSON value."""

    value: Any


@attrs.frozen
class States:
    """The answer to an inventory."""

    components: Mapping[str, ComponentState]


Asks: TypeAlias = Command | Query | Inventory | Refusal
Reply: TypeAlias = Outcome | Result | States


class Request(Protocol):
    """A message that was understood, or refused; it has the place for its answers."""

    @property
    def asks(self) -> Asks:
        """What to do."""
        ...

    def answer(self, reply: Reply) -> tuple[Message, ...]:
        """Return what to publish after it is done; nothing if no one waits for it."""
        ...


class Dialect(Protocol):
    """One protocol, for one device."""

    @property
    def topic(self) -> str:
        """The topic to subscribe to, perhaps with wildcards."""
        ...

    def hears(self, topic: str) -> bool:
        """Return whether messages of a topic belong to it."""
        ...

    def read(self, arrival: Arrival) -> Request | None:
        """Return the request that a message is; None for one that has to be ignored."""
        ...

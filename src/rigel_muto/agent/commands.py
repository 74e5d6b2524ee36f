"""The agent's commands and its answers: the values between MQTT and the cluster.

The protocols make these values from messages, and messages from the answers; an Executor carries
the commands out. Neither side depends on the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any, Literal, Protocol, TypeAlias

import attrs

from rigel_k8s.errors import RigelK8sError

QueryKind = Literal[
    "ping",
    "ros/node",
    "ros/node/info",
    "ros/topic",
    "ros/topic/info",
    "ros/topic/echo",
    "ros/param",
    "ros/param/get",
]


@attrs.frozen(kw_only=True)
class Deploy:
    """A stack that must run, instead of what runs now: what Muto calls start and apply.

    At least one of stack, stack_id and components is given. A stack wins over its id; components
    come alone.

    Attributes:
        identity: finds duplicates: of two commands with one identity the second has no effect.
            "" if the sender gave none: such a command has no duplicates.
        stack: the text of a stack, in any form that rigel_muto/formats.py reads.
        stack_id: the id of the stack, which a protocol also reads from `stack`; a Ditto or the
            agent's own files have it if `stack` is None.
        components: Symphony's components: the text of a stack by the component's name. They
            replace those of the same name, and leave the others as they are
            (`wanted.join` makes one stack of all of them).
    """

    identity: str = ""
    stack: str | None = None
    stack_id: str = ""
    components: Mapping[str, str] = attrs.field(factory=dict)


@attrs.frozen(kw_only=True)
class Kill:
    """Remove what runs.

    Attributes:
        identity: as that of a Deploy.
        stack_id: the id of the stack to remove, "" for any that runs.
        components: names of Symphony's components: only these are removed. Empty: all.
    """

    identity: str = ""
    stack_id: str = ""
    components: tuple[str, ...] = ()


@attrs.frozen
class Query:
    """A question about the ROS graph.

    Attributes:
        arguments: the question's own values, such as `topic`; not the place for the answer.
    """

    kind: QueryKind
    arguments: Mapping[str, Any] = attrs.field(factory=dict)


@attrs.frozen
class Inventory:
    """Symphony's question which of its components exist, by their names."""

    components: tuple[str, ...]


@attrs.frozen
class Refusal:
    """Why a message is refused. Nothing is deployed, and the sender receives the text.

    Attributes:
        kind: a word for programs: malformed, too-large, not-a-stack, unknown-command,
            unsupported.
    """

    kind: str
    message: str


Command: TypeAlias = Deploy | Kill
Asks: TypeAlias = Command | Query | Inventory | Refusal


class Stage(Enum):
    """How far a command has come."""

    ACCEPTED = "accepted"  # its objects are stored; readiness is still waited for
    DONE = "done"  # what it deploys is ready, or what it removes no longer exists
    FAILED = "failed"
    SUPERSEDED = "superseded"  # a newer command has taken its place
    REFUSED = "refused"  # not allowed, or not a stack: nothing has changed


@attrs.frozen
class Outcome:
    """The result of a command; `text` is the cause or a sentence for the sender."""

    stage: Stage
    text: str = ""

    @property
    def succeeded(self) -> bool:
        """Whether the sender need not do anything."""
        return self.stage in (Stage.ACCEPTED, Stage.DONE)


@attrs.frozen
class ComponentState:
    """The state of one of Symphony's components.

    Attributes:
        stack: the text that it was deployed from; None if the component does not exist.
        ready: all its nodes are ready.
        text: why it is not ready, if the cause is known.
    """

    stack: str | None
    ready: bool = False
    text: str = ""


@attrs.frozen
class Result:
    """The answer to a query, a JSON value."""

    value: Any


@attrs.frozen
class States:
    """The answer to an inventory; a component that is missing does not exist."""

    components: Mapping[str, ComponentState]


Reply: TypeAlias = Outcome | Result | States


class Unavailable(RigelK8sError):
    """A command can be neither stored nor refused now, because the cluster cannot be reached.

    A message that the broker keeps (QoS 1) is submitted again later. Of any other one the sender
    gets the error.
    """


class Executor(Protocol):
    """Carries commands out. A RigelK8sError that a method raises is reported to the sender.

    All are called from one thread, one after the other, and return within Symphony's 8 s.
    """

    def submit(self, command: Command) -> Outcome:
        """Return as soon as the command is stored or refused; the long part continues.

        When this returns, the message is acknowledged: a command that is accepted must survive
        the end of the agent.

        Raises:
            Unavailable: submit it again later.
        """
        ...

    def look(self, components: tuple[str, ...]) -> Mapping[str, ComponentState]:
        """Return the states of components; one that is missing does not exist."""
        ...

    def ask(self, query: Query) -> Any:
        """Return the answer as a JSON value, in the shapes of Muto's ROS 1 generation."""
        ...


@attrs.frozen(kw_only=True)
class Arrival:
    """A message as it came, with MQTT 5's ResponseTopic and CorrelationData if it had them."""

    topic: str
    payload: bytes
    response_topic: str | None = None
    correlation: bytes | None = None


@attrs.frozen
class Message:
    """A message to publish.

    Attributes:
        correlation: MQTT 5's CorrelationData.
    """

    topic: str
    payload: bytes
    correlation: bytes | None = None

"""Who waits for a name, lost one, or is silent: what arbitrates between nodes of one name."""

from __future__ import annotations

import attrs


@attrs.frozen
class WaitingNode:
    """A node that has started and waits for its name.

    Attributes:
        api: its URI.
        owner: the URI of the node that has the name, None if no node has it.
    """

    node: str
    api: str
    owner: str | None


@attrs.frozen
class NameConflict:
    """A node that lost its name to a younger one that does not replace it.

    Attributes:
        old: the URI of the node that lost it.
        new: the URI of the node that has it now.
        seconds: how long ago that was.
    """

    node: str
    old: str
    new: str
    seconds: float


@attrs.frozen
class GateStatus:
    """A gate.

    Attributes:
        conflicts: the last ones, oldest first; the gate forgets them when its pod is replaced.
        silent: nodes that have not answered since roscore came back.
        has_master: whether roscore answers it.
        restarts: how often this gate restored the registrations of a new roscore.
        blocked: why calls wait although roscore answers, "" if they do not.
        refused: the registrations and parameters that the last new roscore did not accept, and why.
        unkept: where the gate's state is not kept, and why.
        notes: what else is unusual, in words; an earlier gate has none.
        problem: why the gate did not answer; then nothing else is known.
    """

    waiting: tuple[WaitingNode, ...] = ()
    conflicts: tuple[NameConflict, ...] = ()
    silent: tuple[str, ...] = ()
    has_master: bool = True
    restarts: int = 0
    blocked: str = ""
    refused: tuple[str, ...] = ()
    unkept: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    problem: str = ""

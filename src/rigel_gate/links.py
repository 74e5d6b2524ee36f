"""What the gate needs from outside: the master, the nodes, a clock."""

from __future__ import annotations

from typing import Callable, Protocol, TypeVar

from rigel_gate.calls import Answer, Call

T = TypeVar("T")


class MasterGone(Exception):
    """The master's connection has ended, or no master is there."""


class NodeGone(Exception):
    """No process listens at a node's address any more."""


class NodeSilent(Exception):
    """A node did not answer in time, or its machine cannot be reached."""


class Links(Protocol):
    """The gate's connections, and its clock."""

    async def master(self, call: Call) -> Answer:
        """Call the master; raises MasterGone."""

    async def until_master_hangs_up(self) -> None:
        """Return when the master has ended an idle connection, or no master is there."""

    async def node(self, api: str, call: Call, seconds: float) -> Answer:
        """Call a node; raises NodeGone and NodeSilent."""

    async def connect(self, api: str, seconds: float) -> None:
        """Return when a node's address accepts a connection; raises NodeGone and NodeSilent."""

    async def compute(self, work: Callable[[], T]) -> T:
        """Return what a function returns that takes long; calls are answered meanwhile."""

    async def sleep(self, seconds: float) -> None:
        """Wait."""

    def now(self) -> float:
        """Return the seconds of a monotonic clock."""

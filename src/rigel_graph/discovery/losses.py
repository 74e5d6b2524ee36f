"""Which topics lose messages on the way, from what both ends have counted; pure.

Large messages get lost if the buffers of UDP are too small for their fragments. A node that is too
slow for what arrives loses messages too, in the queue of its subscription, but that is its own
choice: its executor does not wait for work then, so it is not named here.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import attrs

from rigel_exporter.notes import Part, list_parts
from rigel_k8s.problems import Problem

#: Seconds that both ends must have existed for: they find each other some time after their start.
SETTLED = 5.0
#: Messages that were sent at least, and the part of them that is taken if none is lost: the two
#: ends are not read at the same moment.
LEAST, TAKEN = 10, 0.7


@attrs.frozen
class Flow:
    """What one end has sent or taken of a topic between two readings.

    Attributes:
        sent: whether it is a publisher.
        messages: how many, those that it took and did not handle included.
        partners: how many it had, at both readings.
        steady: it existed before, and a publisher sends without long pauses.
        idle: the executors of its process waited for work at both readings.
    """

    node: str
    topic: str
    type: str
    sent: bool
    messages: int
    seconds: float
    partners: int
    steady: bool
    idle: bool

    @property
    def rate(self) -> float:
        """Messages per second."""
        return self.messages / self.seconds


@attrs.frozen
class Loss:
    """A subscriber that takes less of a topic than is sent to it; rates per second."""

    topic: str
    senders: tuple[str, ...]
    sent: float
    node: str
    taken: float

    @property
    def problem(self) -> Problem:
        """What users read."""
        senders = ", ".join(name.lstrip("/") for name in self.senders)
        message = f"{self.topic}: {self.sent:.1f}/s sent by {senders}, {self.taken:.1f}/s taken by"
        remedy = (
            "raise net.core.rmem_max of the machines, or let both share memory: `pod: NAME` at both"
            " nodes; with network: host `shared_memory: true`"
        )
        return Problem(
            ("topics", self.topic),
            f"{message} {self.node.lstrip('/')}",
            "lossy",
            "warning",
            remedy=remedy,
            subjects=(self.node,),
        )


def measure_flows(first: Mapping[str, Any], second: Mapping[str, Any]) -> tuple[Flow, ...]:
    """Return what has passed at a pod's ends between two readings of its notes."""
    seconds = (second["now"] - first["now"]) / 1e9
    before = {(one.process, one.kind, one.name): one for one in list_parts({"": first})}
    ends = (one for one in list_parts({"": second}) if one.kind in ("publisher", "subscription"))
    found = ((before.get((one.process, one.kind, one.name)), one) for one in ends)
    return tuple(measure_flow(old, new, seconds) for old, new in found if old and seconds > 0)


def measure_flow(old: Part, new: Part, seconds: float) -> Flow:
    """Return what has passed at one end."""
    sent = new.kind == "publisher"
    messages = new.messages - old.messages + (0 if sent else new.dropped - old.dropped)
    return Flow(
        new.node,
        new.name,
        new.type,
        sent,
        messages,
        seconds,
        min(old.matched, new.matched),
        old.exists > SETTLED and not (sent and new.gap > seconds / 2),
        old.idle and new.idle,
    )


def find_losses(flows: Iterable[Flow]) -> Iterator[Loss]:
    """Yield the subscribers that lose messages, by topic.

    Not named is one that has just been made, has not found all publishers, has another type, or is
    busy; nor is a topic that is sent seldom or in bursts.
    """
    senders: dict[tuple[str, str], list[Flow]] = defaultdict(list)
    takers: list[Flow] = []
    for flow in flows:
        if flow.sent:
            senders[flow.topic, flow.type].append(flow)
        else:
            takers.append(flow)
    for taker in sorted(takers, key=lambda one: (one.topic, one.node)):
        its = senders[taker.topic, taker.type]
        if not (taker.steady and taker.idle and its and taker.partners >= len(its)):
            continue
        steady = [one for one in its if one.steady and one.partners and one.messages]
        sent = sum(one.rate for one in steady)
        if sum(one.messages for one in steady) >= LEAST and taker.rate < TAKEN * sent:
            names = tuple(sorted({one.node for one in steady}))
            yield Loss(taker.topic, names, sent, taker.node, taker.rate)

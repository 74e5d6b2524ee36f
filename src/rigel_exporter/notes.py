"""What ROS 2 processes note about themselves, as a graph and as counters; pure.

Why: the layer in each process counts what passes, so rates, gaps and ages are exact, for every
middleware, and cost nothing. Its readers (rigel_inpod/rmw_notes.py) answer with JSON: `now`, and
`processes` with their `entities`. All times there are nanoseconds of one machine's clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from rigel_exporter.graph import Graph, Node, Topic, Traffic

Answer = Mapping[str, Any]
_Key = tuple[str, str, str]
#: Messages, bytes, refused, dropped.
_Counts = tuple[int, ...]

#: Modes in which a process says what it has to say; another one waits, or has been replaced.
_WORKING = (0, 3)
_DIRECTIONS = {"publisher": "published", "subscription": "received"}
#: Nodes that are hidden, such as those of tools of the command line.
_HIDDEN = "/_"


class Part(NamedTuple):
    """A publisher, subscription, service or client of a node that works.

    Attributes:
        process: which one it belongs to, and which one it is there.
        kind: `publisher`, `subscription`, `service` or `client`.
        name: of the topic or service.
        silence: seconds since its last message; None before the first one.
        gap: the longest time between two messages in the last minute, in seconds.
        age: seconds from a message's publication to its taking, the last one's; 0 for a publisher.
        exists: seconds since it was made.
        refused: calls that the middleware answered with an error.
        dropped: messages that did not pass while the process waited, or when it was replaced.
        works: its process works; it does not wait, and has not been replaced.
        idle: the executors of its process wait for something to do.
    """

    process: str
    node: str
    kind: str
    name: str
    type: str
    messages: int
    size: int
    matched: int
    silence: float | None
    gap: float
    age: float
    exists: float
    refused: int
    dropped: int
    works: bool
    idle: bool


def list_parts(answers: Mapping[str, Answer]) -> list[Part]:
    """Return the parts of all working nodes, by what each pod answered."""
    return [part for part in _read_parts(answers) if part.works]


def _read_parts(answers: Mapping[str, Answer]) -> Iterator[Part]:
    for place, answer in answers.items():
        for process in answer["processes"]:
            works = process["mode"] in _WORKING and not process["ended"]
            turns = any(one["kind"] == "executor" for one in process["entities"])
            idle = turns and not process["stands"]
            for one in process["entities"]:
                if one["kind"] not in ("node", "executor") and one["node"]:
                    name = f"{place} {process['pid']} {one['created']}"
                    yield _read_part(one, name, answer["now"], works, idle)


def _list_working(answer: Answer) -> Iterator[Mapping[str, Any]]:
    return (one for one in answer["processes"] if one["mode"] in _WORKING and not one["ended"])


def _read_part(one: Mapping[str, Any], process: str, now: int, *state: bool) -> Part:
    silence = max(0.0, (now - one["last"]) / 1e9) if one["last"] else None
    gap = max(one["longest"] / 1e9, silence or 0.0)
    fields = (one["node"], one["kind"], one["name"], one["type"], one["count"], one["bytes"])
    exists = (now - one["created"]) / 1e9
    rest = (exists, one["refused"], one["dropped"], *state)
    return Part(process, *fields, one["matched"], silence, gap, one["age"] / 1e9, *rest)


def list_nodes(answers: Mapping[str, Answer]) -> dict[str, float]:
    """Return the nodes that work, and for how many seconds each has not looked for work."""
    found: dict[str, float] = {}
    for _, process, one in _list_working_nodes(answers):
        found[one["name"]] = max(process["stands"] / 1e9, found.get(one["name"], 0.0))
    return found


def _list_working_nodes(answers: Mapping[str, Answer]) -> Iterator[tuple[str, Any, Any]]:
    """Yield each node that works, behind its pod and its process."""
    for place, answer in answers.items():
        for process in _list_working(answer):
            for one in process["entities"]:
                if one["kind"] == "node":
                    yield place, process, one


def list_discovered(answers: Mapping[str, Answer]) -> set[str]:
    """Return the nodes that the processes have discovered, without those of tools."""
    seen = (name for a in answers.values() for one in a["processes"] for name in one["seen"])
    return {name for name in seen if _HIDDEN not in name}


def list_cut_off(answers: Mapping[str, Answer]) -> set[str]:
    """Return the nodes of pods that no other pod has met, while others have met each other."""
    owner = {name: place for place in answers for name in list_nodes({place: answers[place]})}
    met: set[str] = set()
    for place, answer in answers.items():
        for name in (name for one in _list_working(answer) for name in one["seen"]):
            if owner.get(name, place) != place:
                met |= {place, owner[name]}
    return {name for name, place in owner.items() if met and place not in met}


class Counters:
    """What nodes have published and received; it goes on when a process is replaced.

    What a process has counted before it was replaced is added too. A pod that does not answer for a
    while has its numbers kept; of all, the latest MOST are.
    """

    MOST = 20_000

    def __init__(self) -> None:
        self._seen: dict[_Key, _Counts] = {}
        self._totals: dict[_Key, _Counts] = {}

    def take(self, answers: Mapping[str, Answer]) -> Graph:
        """Take in what the pods have answered, and return the graph that it shows."""
        flows: dict[_Key, list[Part]] = {}
        topics: dict[tuple[str, str], list[int]] = {}
        for part in _read_parts(answers):
            if part.kind in _DIRECTIONS:
                key = part.node, part.name, _DIRECTIONS[part.kind]
                if part.works:
                    flows.setdefault(key, []).append(part)
                    counts = topics.setdefault((part.name, part.type), [0, 0])
                    counts[part.kind == "subscription"] += 1
                self._count(key, part)
        for kept in (self._seen, self._totals):
            for old in list(kept)[: -self.MOST]:
                del kept[old]
        own, cut_off = list_nodes(answers), list_cut_off(answers)
        others = sorted(list_discovered(answers) - set(own))
        processes = {
            one["name"]: (place, str(one["created"]))
            for place, _, one in _list_working_nodes(answers)
        }
        nodes = [
            Node(n, up=True, registered=n not in cut_off, stands=own[n], process=processes[n])
            for n in own
        ]
        return Graph(
            nodes=[*nodes, *(Node(name, up=True, registered=True) for name in others)],
            topics=[Topic(*key, *counts) for key, counts in topics.items()],
            traffic=[_add_up(key, self._totals[key], its) for key, its in sorted(flows.items())],
        )

    def _count(self, key: _Key, part: Part) -> None:
        """Add what has passed since the last look; one that waits is counted once it works."""
        own_key = part.process, part.name, part.kind
        if not part.works and own_key not in self._seen:
            return
        now = part.messages, part.size, part.refused, part.dropped
        before, total = self._seen.pop(own_key, (0,) * 4), self._totals.pop(key, (0,) * 4)
        self._seen[own_key] = now
        grown = [max(0, new - old) for new, old in zip(now, before)]
        self._totals[key] = tuple(map(sum, zip(total, grown)))


def _add_up(key: _Key, totals: _Counts, its: Iterable[Part]) -> Traffic:
    """Return one node's traffic on a topic; of several publishers the state of the latest."""
    last = min(its, key=lambda part: (part.silence is None, part.silence or 0.0))
    messages, size, refused, dropped = totals
    made = Traffic(*key, messages, size, last.matched, last.silence, last.gap, last.age)
    return made._replace(refused=refused, dropped=dropped)

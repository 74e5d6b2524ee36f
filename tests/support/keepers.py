"""Pods of one workload, their network and their nodes, in simulated time: for handover.py.

Each pod has a real Handover and a simulated node: three queues (a topic, a service, an action's
goals), one thread that takes from them and is busy for a while, and the modes of the layer. Clients
send numbered messages, requests and goals to all nodes there are. The world checks at each moment
what the protocol promises, and `judge` what has become of everything that was sent.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

WORK, WAIT, HOLD, FINISH, STOP = range(5)
KINDS = ("topic", "service", "goal")
DRAIN = 4.0
CUT = 2.2  # seconds of silence after which the kernel ends a connection
ENDLESS = 1000.0  # the length of a goal that no drain waits for


class Broken(Exception):
    """The protocol has broken a promise."""


class Node:
    """A pod's processes, with the interface of rmw_notes.Notes."""

    def __init__(self, world: World, pod: Pod) -> None:
        self.world, self.pod = world, pod
        self.mode, self.hold_goals = WAIT, False
        self.ready_at = world.now + world.chance.uniform(0.0, 2.0)
        #: When its constructor has made its last part, without which nothing can be found.
        self.complete_at = self.ready_at + world.chance.choice([0.0, 0.5, 3.0])
        #: When the clients know it: it knows them earlier, and cannot see whether they do.
        self.found_at = self.ready_at + world.chance.choice([1.0, 2.0, 6.0])
        self.queues: dict[str, list[tuple[int, float]]] = {kind: [] for kind in KINDS}
        self.numbers: dict[str, dict[str, int]] = {"taken": {}, "dropped": {}}
        self.heard: dict[str, float] = {}
        self.neighbors: list[str] = []
        self.newcomers = 0  # new versions of its partners, which only it has discovered
        self.drop: dict[str, Any] = {}
        self.taking, self.busy, self.ended = False, False, False
        self.open: dict[int, bool] = {}
        self.world.after(0.0, self.turn)

    def alive(self) -> bool:
        return not self.ended and self.world.now >= self.ready_at

    def identify(self) -> list[int]:
        return [id(self)]

    def fit(self) -> bool:
        return self.alive() and self.world.now >= self.ready_at + 0.3

    def survey(self) -> tuple[list[str], dict[str, int]]:
        count = 1 if self.world.now >= self.ready_at + 0.8 else 0
        late = self.world.now >= self.ready_at + 1.0
        kinds = KINDS if self.world.now >= self.complete_at else KINDS[1:]
        partners = dict.fromkeys(kinds, count * (1 + self.newcomers))
        return ["node", "late"] if late else ["node"], partners

    def doubled(self) -> int:
        return self.newcomers

    def name(self, keys: set[str]) -> list[str]:
        return sorted(keys)

    def friends(self) -> list[str]:
        return []

    def set_others(self, prefixes: list[str]) -> None:
        """Clients here are no process of a pod."""

    def set_known(self, prefixes: list[str]) -> None:
        """Nor does one of them wait for its own pod's servers."""

    def is_taking(self) -> bool:
        return self.taking

    def is_idle(self) -> bool:
        return not self.busy

    def has_actions(self) -> bool:
        return self.world.actions

    def goals(self) -> dict[str, bool]:
        return {f"{number:032x}": is_open for number, is_open in self.open.items()}

    def unanswered(self) -> int:
        return sum(self.open.values())

    def newest(self) -> dict[str, dict[str, int]]:
        return {kind: {"w": number} for kind, number in self.numbers["taken"].items()}

    def dropped(self) -> dict[str, dict[str, int]]:
        return {kind: {"w": number} for kind, number in self.numbers["dropped"].items()}

    def agree(self, fit: bool) -> bool:  # noqa: FBT001  # as in keeper.py
        return fit

    def inside(self) -> list[str]:
        return self.neighbors

    def hears(self, within: float) -> dict[str, list[str]]:
        since = self.world.now - within
        return {kind: ["w"] for kind, when in self.heard.items() if when > since}

    def write_drop(self, newest: dict[str, Any], uuids: list[str]) -> None:
        self.drop = newest

    def set_mode(self, mode: int) -> None:
        self.mode = mode
        self.world.watch()

    def set_hold_goals(self, hold: bool) -> None:  # noqa: FBT001  # as in rmw_notes.py
        self.hold_goals = hold

    def offer(self, kind: str, number: int, length: float) -> None:
        is_there = kind != KINDS[0] or self.world.now >= self.complete_at + 1.0
        if not self.ended and is_there and self.world.now >= self.found_at:
            self.queues[kind].append((number, length))

    def turn(self) -> None:
        """Take one thing, if the mode lets it, and be busy with it."""
        if self.ended:
            return
        chance = self.world.chance
        kinds = [k for k in KINDS if self.queues[k] and not (k == "goal" and self.hold_goals)]
        if self.world.now < self.ready_at or self.mode >= HOLD or not kinds:
            self.world.after(chance.uniform(0.001, 0.01), self.turn)
            return
        kind, mode = chance.choice(kinds), self.mode
        number, length = self.queues[kind].pop(0)
        self.taking = True

        def end_taking() -> None:
            if self.ended:
                return
            self.taking = False
            done = number <= self.drop.get(kind, {}).get("w", 0)
            note = self.numbers["taken" if mode == WORK and not done else "dropped"]
            note[kind] = max(number, note.get(kind, 0))
            self.heard[kind] = self.world.now
            if mode == WORK and not done:
                self.busy = True
                self.world.handle(self, kind, number, length)
                pause = chance.choice([0.0, 0.002, 0.02, 0.3 if chance.random() < 0.02 else 0.0])
                pause = max(pause, self.world.work)
                self.world.after(pause, end_work)
            else:
                self.world.after(0.0, self.turn)

        def end_work() -> None:
            self.busy = False
            self.turn()

        self.world.after(chance.choice([0.0, 0.001, 0.005]), end_taking)


class Link:
    """A connection between two keepers; what is sent while the network is cut arrives late.

    After CUT seconds the kernel ends it; if the network is whole then, the other end is told.
    """

    def __init__(self, world: World, ends: tuple[Pod, Pod]) -> None:
        self.world, self.ends = world, ends
        self.open = [True, True]
        self.due = [0.0, 0.0]
        self.stuck: list[float | None] = [None, None]

    def send(self, sender: Pod, message: dict[str, Any] | None) -> None:
        side = self.ends.index(sender)
        if not self.open[side]:
            return
        if message is None:
            self.open[side] = False
            sender.links.pop(self, None)
        elif (message := sender.version(message)) is None:
            return
        arrives = max(self.due[1 - side], self.world.now + self.world.delay())
        self.due[1 - side] = arrives
        self.world.at(arrives, lambda: self._arrive(1 - side, message))

    def _arrive(self, side: int, message: dict[str, Any] | None) -> None:
        pod, now = self.ends[side], self.world.now
        if self.ends[1 - side].lost:
            return
        if pod.lost or self.world.is_cut(*self.ends):
            begun = self.stuck[side] = self.stuck[side] or now
            if now - begun >= CUT:
                self._close(1 - side, "does not answer")
                return
            self.world.after(0.1, lambda: self._arrive(side, message))
            self.due[side] = now + 0.1
            return
        self.stuck[side] = None
        if not self.open[side]:
            self._close(1 - side, "ended")
        elif pod.keeper is not None:
            if message is None:
                self.open[side] = False
                pod.links.pop(self, None)
                pod.event(lambda keeper: keeper.closed(self.world.now, self))
            else:
                pod.event(lambda keeper: keeper.received(self.world.now, self, message))

    def _close(self, side: int, how: str) -> None:
        pod = self.ends[side]
        if self.open[side] and pod.keeper is not None:
            self.open[side] = False
            pod.links.pop(self, None)
            pod.event(lambda keeper: keeper.closed(self.world.now, self, how))


class Side:
    """What a keeper has of its node, whichever runs now."""

    def __init__(self, pod: Pod) -> None:
        self.pod = pod

    def __getattr__(self, name: str) -> Any:
        return getattr(self.pod.node, name)


class Pod:
    """A pod: its keeper, its node, and what its volume keeps."""

    def __init__(self, world: World, name: str, blind: float = 0.0) -> None:
        """`blind`: for how many seconds it finds no other pod."""
        self.world, self.name, self.born = world, name, world.now
        self.finds_at = world.now + blind
        self.found_at = world.now + world.chance.uniform(0.0, 1.0)
        self.term, self.runs, self.killed, self.lost = 0, 0, False, False
        self.links: dict[Link, None] = {}
        self.keeper: Any = None
        self.stalled_until = 0.0
        self.waits_for_tick = 0.0
        self.events: list[Callable[[Any], object]] = []
        self.lines: list[str] = []
        #: What its keeper says, as another version would say it; None for what that does not say.
        self.version: Callable[[dict[str, Any]], dict[str, Any] | None] = lambda message: message
        self.node = Node(world, self)
        self.run()

    def run(self) -> None:
        """Start the keeper, the first time or again."""
        if self.killed:
            return
        world, self.runs = self.world, self.runs + 1
        who = world.code.Identity("w", self.name, str(self.runs), self.born)
        self.keeper = world.code.Handover(
            who, Side(self), self.save, self.report, drain=DRAIN, term=self.term
        )
        self.keeper.start(world.now, works=self.node.mode == WORK)
        self.look(self.runs, world.now + 2.0)
        self.dial(self.runs)
        self.tick()

    def look(self, run: int, limit: float) -> None:
        """End the first look when all that can be found have answered, or after two seconds."""
        world = self.world
        if self.keeper is None or self.runs != run:
            return
        others = [p for p in world.pods if self.finds(p)]
        if all(p.name in self.keeper.peers for p in others) or world.now >= limit:
            self.event(lambda keeper: keeper.looked(world.now))
        else:
            world.after(0.005, lambda: self.look(run, limit))

    def finds(self, other: Pod) -> bool:
        """Whether a connection to another pod can be made."""
        now, world = self.world.now, self.world
        known = now >= self.finds_at and (now >= other.found_at or other.born == self.born)
        return (
            other is not self
            and known
            and other.keeper is not None
            and not world.is_cut(self, other)
        )

    def save(self, term: int) -> None:
        self.term = term

    def report(self, step: str, line: str) -> None:
        if not self.lines or self.lines[-1] != line:
            self.lines.append(line)
            if "after 1 s" in line:  # the old node was too busy for an exact switch, and it says so
                self.world.exact, self.world.late = False, self.world.late + 1
            self.world.log(f"{self.name}: {line}")

    def dial(self, run: int) -> None:
        """Connect to those that are known and not connected."""
        world = self.world
        if self.keeper is None or self.runs != run:
            return
        met = {end for link in self.links for end in link.ends}
        for other in world.pods:
            if other not in met and self.finds(other):
                link = Link(world, (self, other))
                for pod in (self, other):
                    pod.links[link] = None
                    pod.event(lambda keeper, link=link: keeper.opened(world.now, link))
        world.after(world.chance.uniform(0.005, 0.2), lambda: self.dial(run))

    def event(self, happen: Callable[[Any], object]) -> None:
        """Let the keeper see something at the next turn of its loop, which sees all there is."""
        if self.keeper is None:
            return
        self.events.append(happen)
        if len(self.events) == 1:
            run = self.runs
            due = max(self.world.now, self.stalled_until)
            self.world.at(due, lambda: self.runs == run and self.turn())

    def turn(self) -> None:
        """One turn of the keeper's loop, unless it gets no processor."""
        if self.keeper is None or not self.events:
            return
        if self.world.now < self.stalled_until:
            self.world.at(self.stalled_until, self.turn)
            return
        events, self.events = self.events, []
        for happen in events:
            happen(self.keeper)
        self.tick()

    @property
    def leaves(self) -> bool:
        """Whether it has said goodbye; it works until the next one's node runs."""
        return self.keeper is not None and bool(self.keeper.role == "left")

    def tick(self) -> None:
        if self.keeper is None:
            return
        wait = self.keeper.tick(self.world.now)
        box, self.keeper.outbox = self.keeper.outbox, []
        for link, message in box:
            link.send(self, message)
        due = self.world.now + max(wait, 0.001)
        if not self.waits_for_tick or due < self.waits_for_tick:
            self.waits_for_tick = due
            self.world.at(due, self._tick_due)

    def _tick_due(self) -> None:
        if self.world.now < self.waits_for_tick:
            return  # an earlier one has come
        self.waits_for_tick = 0.0
        self.event(lambda keeper: None)

    def end_keeper(self) -> None:
        """The keeper's process ends; the kernel closes its connections."""
        self.keeper, self.events = None, []
        for link in list(self.links):
            link.send(self, None)

    def crash_node(self) -> None:
        """The node ends, and something in the container starts it again."""
        old, self.node = self.node, Node(self.world, self)
        old.ended = True
        self.node.mode, self.node.hold_goals, self.node.drop = old.mode, old.hold_goals, old.drop

    def crash(self) -> None:
        """The container ends, and Kubernetes starts it again."""
        self.node.ended = True
        self.end_keeper()
        self.node = Node(self.world, self)
        self.world.after(0.5, self.run)

    def crash_keeper(self) -> None:
        """The keeper ends, and is started again."""
        if self.keeper is None:
            return
        self.end_keeper()
        self.world.after(self.world.chance.uniform(0.02, 0.4), self.run)

    def kill(self) -> None:
        self.killed = self.node.ended = True
        self.end_keeper()
        self.world.watch()

    def lose(self) -> None:
        """Its machine loses its power: nothing says to the others that it has ended."""
        self.lost = True
        self.kill()


class World:
    """Pods, clients and time."""

    def __init__(self, code: ModuleType, seed: int, *, actions: bool) -> None:
        self.code, self.chance, self.actions = code, random.Random(seed), actions
        self.now, self.count, self.heap = 0.0, 0, []  # type: ignore[var-annotated]
        self.pods: list[Pod] = []
        self.cuts: set[frozenset[str]] = set()
        self.slow = 1.0
        self.work = 0.0  # seconds that nodes are busy with each thing, at least
        self.handled: dict[tuple[str, int], list[Pod]] = {}
        self.sent: dict[tuple[str, int], float] = {}
        self.finished: set[int] = set()
        self.excused_until = 0.0  # two may work until then, or none
        self.exact = True  # nothing has happened for which something may be lost or doubled
        self.none_since: float | None = None
        self.two_since = 0.0
        self.late = 0
        self.history: list[str] = []

    def log(self, line: str) -> None:
        self.history.append(f"{self.now:8.3f} {line}")

    def at(self, when: float, happen: Callable[[], object]) -> None:
        self.count += 1
        heapq.heappush(self.heap, (when, self.count, happen))

    def after(self, seconds: float, happen: Callable[[], object]) -> None:
        self.at(self.now + seconds, happen)

    def run(self, until: float) -> None:
        while self.heap and self.heap[0][0] <= until:
            self.now, _, happen = heapq.heappop(self.heap)
            happen()
            self.watch()
        self.now = until

    def delay(self) -> float:
        return self.slow * self.chance.choice([0.0, 0.0005, 0.003, 0.03])

    def is_cut(self, one: Pod, other: Pod) -> bool:
        return frozenset((one.name, other.name)) in self.cuts

    def excuse(self, seconds: float) -> None:
        self.excused_until = max(self.excused_until, self.now + seconds)

    # ---- What clients send --------------------------------------------------------------------

    def send(self, kind: str, number: int, length: float = 0.0) -> None:
        self.sent[kind, number] = self.now
        arrivals = [(pod, self.chance.choice([0.0, 0.001, 0.01])) for pod in self.pods]
        for pod, delay in arrivals:
            node = pod.node
            due = max(getattr(node, "due_" + kind, 0.0), self.now + delay)
            setattr(node, "due_" + kind, due)
            self.at(due, lambda node=node: node.offer(kind, number, length))

    def handle(self, node: Node, kind: str, number: int, length: float) -> None:
        self.handled.setdefault((kind, number), []).append(node.pod)
        if kind == "goal":
            node.open[number] = True
            self.after(length, lambda: self._finish(node, number))

    def _finish(self, node: Node, number: int) -> None:
        if not node.ended:
            node.open[number] = False
            self.finished.add(number)

    def feed(self, until: float) -> None:
        """Send without pause."""
        for kind, pause in (("topic", 0.03), ("service", 0.05)):
            self._feed(kind, 1, pause, until)
        if self.actions:
            self._feed("goal", 1, 0.9, until)

    def _feed(self, kind: str, number: int, pause: float, until: float) -> None:
        if self.now < until:
            self.send(kind, number, self.chance.choice([0.2, 1.0, 2.5]))
            again = self.chance.uniform(0.3, 1.0) * pause
            self.after(again, lambda: self._feed(kind, number + 1, pause, until))

    # ---- What is promised ---------------------------------------------------------------------

    def watch(self) -> None:
        """Check that at most one node works, and that one does soon."""
        living = [pod for pod in self.pods if pod.node.alive()]
        working = [p.name for p in living if p.node.mode in (WORK, FINISH) and not p.leaves]
        if self.now <= self.excused_until or self.cuts:
            self.none_since, self.two_since = None, 0.0
            return
        # Two whose nodes start at the same moment when no one works hear of each other soon.
        self.two_since = self.two_since or self.now if len(working) > 1 else 0.0
        if self.two_since and (self.exact or self.now - self.two_since > 0.3):
            raise Broken(f"{' and '.join(working)} work at {self.now:.3f}")
        able = [pod for pod in living if pod.keeper is not None]
        if working or not able:
            self.none_since = None
        elif self.none_since is None:
            self.none_since = self.now
        elif self.now - self.none_since > 4.5:
            raise Broken(f"no one works at {self.now:.3f}")

    def judge(self) -> None:
        """Check that all was done once, and that the youngest pod works."""
        living = [pod for pod in self.pods if not pod.killed]
        for pod in living:
            if pod is not living[-1] and pod.node.mode in (WORK, FINISH):
                raise Broken(f"{pod.name} still works")
        if living and living[-1].node.mode != WORK:
            raise Broken(f"stuck: {living[-1].name} does not work")
        if self.exact:
            for what in self.problems():
                raise Broken(what)

    def problems(self) -> Iterator[str]:
        """Yield what was lost or done twice, since the first one worked."""
        first = min((self.sent[key] for key in self.handled), default=0.0)
        for (kind, number), when in self.sent.items():
            times = len(self.handled.get((kind, number), []))
            if times > 1:
                names = [pod.name for pod in self.handled[kind, number]]
                yield f"{kind} {number}, sent at {when:.3f}, was handled by {names}"
            if times == 0 and when > first:
                yield f"{kind} {number}, sent at {when:.3f}, was lost"
            if kind == "goal" and times == 1 and number not in self.finished:
                yield f"goal {number} was never finished"

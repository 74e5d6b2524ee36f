"""A ROS graph without sockets: a master, pods with nodes, the Kubernetes that replaces them.

Time is virtual: a loop that has nothing to do goes on to its next timer. So a minute takes
milliseconds, and a seed decides in which order everything happens.
"""

from __future__ import annotations

import asyncio
import json
import random
import selectors
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from rigel_gate.calls import GATE, Answer, Call, call_of, registration_of, removal_of
from rigel_gate.gate import Gate
from rigel_gate.handover import BOND
from rigel_gate.links import MasterGone, NodeGone, NodeSilent
from rigel_gate.memory import replay
from rigel_gate.parameters import Parameters, leaves
from rigel_gate.registry import (
    PARAMETER,
    PUBLISHER,
    SERVICE,
    SUBSCRIBER,
    Registration,
    host_of,
    resolve_name,
)
from rigel_gate.state import State, line_of

#: Virtual seconds that a test may take.
LONGEST = 3600.0
#: How topics of bonds end.
BOND_TOPIC = "/bond"

T = TypeVar("T")


class _Selector(selectors.DefaultSelector):
    """Waits no time at all, and moves the clock instead."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def select(self, timeout: float | None = None) -> list[Any]:
        if timeout:
            self.now += timeout
        return super().select(0)


def run(work: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run a coroutine in virtual time; one that never ends fails after LONGEST."""
    selector = _Selector()
    loop = asyncio.SelectorEventLoop(selector)
    loop.time = lambda: selector.now  # type: ignore[method-assign]
    try:
        loop.run_until_complete(asyncio.wait_for(work(), LONGEST))
    finally:
        pending = asyncio.all_tasks(loop)
        for task in pending:
            task.cancel()
        loop.run_until_complete(asyncio.gather(*pending, return_exceptions=True))
        loop.close()


class SimMaster:
    """rosmaster, by its own rules; what it tells nodes arrives a little later, in order."""

    def __init__(self, world: World, run_id: str) -> None:
        self.world = world
        self.nodes: dict[str, str] = {}
        self.registered: dict[tuple[str, str], list[tuple[str, str]]] = {}
        self.details: dict[tuple[str, str], str] = {}
        self.parameters = Parameters()
        self.parameters.set("/run_id", run_id)

    def answer(self, call: Call) -> Answer:
        if call.method == "system.multicall":
            calls = [Call(one["methodName"], tuple(one["params"])) for one in call.params[0]]
            return Answer([[self.answer(one).value] for one in calls])
        if one := registration_of(call):
            return self._register(one)
        if removal := removal_of(call):
            return self._unregister(*removal)
        return getattr(self, f"_{call.method}")(*call.params)

    def apis(self, kind: str, key: str) -> list[str]:
        return [api for _, api in self.registered.get((kind, key), [])]

    def _register(self, one: Registration) -> Answer:
        before = self.nodes.get(one.node)
        if before is not None and before != one.api:
            self.world.bumped(one, before)
            for key, names in list(self.registered.items()):
                self.registered[key] = [pair for pair in names if pair[0] != one.node]
            self.world.later(before, "shutdown", "new node registered with same name")
        self.nodes[one.node] = one.api
        self.world.owners.append((one.node, one.api))
        names = self.registered.setdefault((one.kind, one.key), [])
        if (one.node, one.api) not in names:
            names.append((one.node, one.api))
        self.details[one.kind, one.key] = one.detail
        if one.kind == PUBLISHER:
            self._notify(one.key)
            return Answer.good("", self.apis(SUBSCRIBER, one.key))
        if one.kind == SUBSCRIBER:
            return Answer.good("", self.apis(PUBLISHER, one.key))
        return Answer.good("", self.parameters.get(one.key) if one.kind == PARAMETER else 1)

    def _unregister(self, kind: str, key: str, node: str, uri: str) -> Answer:
        names = self.registered.get((kind, key), [])
        api = self.nodes.get(node, "") if kind == SERVICE else uri
        if (node, api) not in names or (kind == SERVICE and self.details[kind, key] != uri):
            return Answer.good("", 0)
        names.remove((node, api))
        if kind == PUBLISHER:
            self._notify(key)
        if not any(node == name for known in self.registered.values() for name, _ in known):
            del self.nodes[node]
        return Answer.good("", 1)

    def _notify(self, topic: str) -> None:
        for api in self.apis(SUBSCRIBER, topic):
            self.world.later(api, "publisherUpdate", topic, self.apis(PUBLISHER, topic))

    def _getSystemState(self, _: str) -> Answer:
        parts = []
        for kind in (PUBLISHER, SUBSCRIBER, SERVICE):
            found = {k: names for (what, k), names in self.registered.items() if what == kind}
            parts.append([[k, [name for name, _ in names]] for k, names in found.items() if names])
        return Answer.good("", parts)

    def _getTopicTypes(self, _: str) -> Answer:
        return Answer.good(
            "", [[k, d] for (what, k), d in self.details.items() if what == PUBLISHER]
        )

    def _lookupNode(self, _: str, name: str) -> Answer:
        return Answer([1, "", self.nodes[name]] if name in self.nodes else [-1, "unknown node", ""])

    def _lookupService(self, caller: str, name: str) -> Answer:
        name = resolve_name(name, caller)
        if not self.apis(SERVICE, name):
            return Answer([-1, "no provider", ""])
        return Answer.good("", self.details[SERVICE, name])

    def _getParam(self, caller: str, key: str) -> Answer:
        found = self.parameters.get(resolve_name(key, caller))
        return Answer([-1, "not set", 0] if found == {} else [1, "", found])

    def _hasParam(self, caller: str, key: str) -> Answer:
        return Answer.good("", self.parameters.get(resolve_name(key, caller)) != {})

    def _getParamNames(self, _: str) -> Answer:
        return Answer.good(
            "", [n for k, v in self.parameters.tree.items() for n in leaves(v, "/" + k)]
        )

    def _setParam(self, caller: str, key: str, value: Any) -> Answer:
        key = resolve_name(key, caller)
        self.parameters.set(key, value)
        for (kind, wanted), names in self.registered.items():
            if kind == PARAMETER and wanted == key:
                for _, api in names:
                    self.world.later(api, "paramUpdate", key, value)
        return Answer.good("", 0)

    def _deleteParam(self, caller: str, key: str) -> Answer:
        self.parameters.delete(resolve_name(key, caller))
        return Answer.good("", 0)


class SimNode:
    """A node: registers one thing after the other, and stops when it is told to.

    Attributes:
        registered: what the master, or the gate, has confirmed.
        offers: what the node has by its own account: earlier than it is registered, and gone
            earlier than it is unregistered, as in rospy and roscpp.
        heard: topic -> the list of publishers that came last.
        lists: (topic, list) of all that came, in order.
        learnt: parameter -> the value that came last.
        stops: it has been told to end.
        lingers: seconds for which it then goes on to publish, and a moment more.
    """

    def __init__(self, world: World, pod: SimPod, name: str, port: int, plan: Plan) -> None:
        self.world, self.pod, self.name = world, pod, name
        self.api = f"http://{pod.host}:{port}/"
        self.plan = list(plan)
        self.alive = True
        self.stops = False
        self.lingers = 0.0
        self.registered: set[tuple[str, str]] = set()
        self.offers: set[tuple[str, str]] = set()
        self.heard: dict[str, list[str]] = {}
        self.lists: list[tuple[str, list[str]]] = []
        self.learnt: dict[str, Any] = {}
        world.listening[self.api] = self

    async def start(self) -> None:
        for entry in list(self.plan):
            await asyncio.sleep(self.world.pause(0.3))
            if not self.alive:
                return
            await self.register(*entry)

    def detail(self, kind: str, key: str) -> str:
        found = {SERVICE: f"rosrpc://{self.pod.host}{key}", PARAMETER: ""}
        return found.get(kind, BOND if key.endswith(BOND_TOPIC) else "t/T")

    async def register(self, kind: str, key: str) -> Answer:
        """Register one thing, as a client library does."""
        self.offers.add((kind, key))
        one = Registration(kind, key, self.name, self.api, self.detail(kind, key))
        await self.world.reach(self.pod.host)
        hands_over = self.pod.workload is not None
        answer = await self.world.call(call_of(one), hands_over=hands_over, caller=self)
        if not answer.is_success:
            return answer
        self.registered.add((kind, key))
        if kind == SUBSCRIBER and key not in self.heard:
            self._hear(key, answer.result)
        if kind == PARAMETER:
            self.learnt.setdefault(key, answer.result)
        return answer

    async def unregister(self, *entries: tuple[str, str]) -> Answer:
        """Take things back in one `system.multicall`, as rospy does."""
        self.offers -= set(entries)
        answer = await self._unregister(*entries)
        self.registered -= set(entries)
        return answer

    async def _unregister(self, *entries: tuple[str, str]) -> Answer:
        calls = []
        for kind, key in entries:
            uri = self.detail(kind, key) if kind == SERVICE else self.api
            words = (self.name, uri, key) if kind == PARAMETER else (self.name, key, uri)
            method = {PARAMETER: "unsubscribeParam"}.get(kind, f"unregister{kind.capitalize()}")
            calls.append({"methodName": method, "params": words})
        await self.world.reach(self.pod.host)
        return await self.world.call(
            Call("system.multicall", (calls,)), hands_over=self.pod.workload is not None
        )

    def take(self, method: str, *params: Any) -> Any:
        if method == "publisherUpdate":
            self._hear(params[0], list(params[1]))
        elif method == "paramUpdate":
            self.learnt[params[0]] = params[1]
        elif method == "shutdown" and not self.stops:
            self.stops = True
            self.world.spawn(self._stop())
        elif method == "getPublications":
            return [[key, "t/T"] for kind, key in sorted(self.offers) if kind == PUBLISHER]
        return 0

    def _hear(self, topic: str, publishers: list[str]) -> None:
        self.world.heard(self, topic, publishers)
        self.heard[topic] = publishers
        self.lists.append((topic, publishers))

    async def _stop(self) -> None:
        """End as rospy does when it is shut down: it publishes until it has unregistered all."""
        await asyncio.sleep(self.lingers + self.world.pause(0.05))
        await self._unregister(*sorted(self.registered))
        self.end()

    async def leave(self) -> None:
        """End in order, as after SIGINT: what listens is closed first."""
        self.alive = False
        self.world.listening.pop(self.api, None)
        await self.unregister(*sorted(self.registered))

    def end(self) -> None:
        self.alive = False
        self.world.listening.pop(self.api, None)


class SimPod:
    """A pod of a workload, or None for one that is not ours."""

    def __init__(self, host: str, workload: str | None) -> None:
        self.host, self.workload = host, workload
        self.nodes: list[SimNode] = []
        self.leaving = False


Plan = list[tuple[str, str]]


class World:
    """Everything around the gate; `Links` of the gate."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.listening: dict[str, SimNode] = {}
        self.unreachable: set[str] = set()  # hosts of machines that are away
        self.lost: dict[str, float] = {}  # host -> when its machine was last away
        self.pods: list[SimPod] = []
        self.broken: list[str] = []
        self.journal: list[bytes] = []
        self.runs = 0
        self.master_now: SimMaster | None = None
        self.gate: Gate | None = None
        self.ended = asyncio.Event()
        self.log: list[str] = []
        self.queues: dict[str, asyncio.Queue[tuple[str, tuple[Any, ...]]]] = {}
        self.tasks: set[asyncio.Task[Any]] = set()
        self.owners: list[tuple[str, str]] = []  # (node, api): who got which name, in order
        self._hosts = iter(range(1, 10000))
        self._ports = iter(range(40000, 65000))
        self.start_master()

    # -- Links --

    async def master(self, call: Call) -> Answer:
        await asyncio.sleep(self.pause(0.002))
        master = self.master_now
        if master is None:
            raise MasterGone("refused")
        answer = master.answer(call)
        await asyncio.sleep(self.pause(0.002))
        if self.master_now is not master:
            raise MasterGone("reset")
        return answer

    async def until_master_hangs_up(self) -> None:
        if self.master_now is not None:
            await self.ended.wait()

    def hang_up(self) -> None:
        """End the master's idle connections, as a roscore with a timeout does."""
        self.ended.set()
        self.ended = asyncio.Event()

    async def node(self, api: str, call: Call, seconds: float) -> Answer:
        await self.connect(api, seconds)
        await asyncio.sleep(self.pause(0.01))
        node = self.listening.get(api)
        if node is None:
            raise NodeGone("refused")
        return Answer.good("", node.take(call.method, *call.params[1:]))

    async def connect(self, api: str, seconds: float) -> None:
        await asyncio.sleep(self.pause(0.01))
        if host_of(api) in self.unreachable:
            await asyncio.sleep(seconds)
            raise NodeSilent("no answer")
        if api not in self.listening:
            raise NodeGone("refused")

    async def compute(self, work: Callable[[], T]) -> T:
        return work()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    def now(self) -> float:
        return asyncio.get_running_loop().time()

    # -- what happens --

    def pause(self, most: float) -> float:
        return self.random.random() * most

    def was_away(self, host: str) -> bool:
        """Whether a machine is away, or was a moment ago: the gate may still think so."""
        return host in self.unreachable or self.now() < self.lost.get(host, -60) + 10

    async def reach(self, host: str) -> None:
        """Wait while a machine is away."""
        while host in self.unreachable:
            await asyncio.sleep(0.1)

    def spawn(self, work: Coroutine[Any, Any, Any]) -> None:
        task = asyncio.ensure_future(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def start_master(self) -> None:
        self.runs += 1
        self.ended = asyncio.Event()
        self.master_now = SimMaster(self, f"run {self.runs}")

    def kill_master(self) -> None:
        self.master_now = None
        self.ended.set()

    def start_gate(self) -> None:
        state = replay(self.journal) if self.journal else State()

        def keep(event: list[Any]) -> None:
            if self.gate is own:
                self.journal.append(line_of(json.loads(json.dumps(event))))

        own = self.gate = Gate(state, self, "http://ros-master:11311/", keep, self.log.append)
        own.start()

    async def kill_gate(self) -> None:
        """Calls that are under way are lost: whoever made them makes them again."""
        gate, self.gate = self.gate, None
        if gate:
            await gate.stop()

    async def call(
        self,
        call: Call,
        *,
        hands_over: bool = False,
        caller: SimNode | None = None,
        host: str = "",
    ) -> Answer:
        """Make a call as a client library does: again, where the connection is lost.

        What a `caller` that has ended meanwhile has asked for is carried out all the same.
        """
        while True:
            gate = self.gate
            if gate is None:
                await asyncio.sleep(0.05)
                continue
            work = asyncio.ensure_future(gate.answer(call, hands_over=hands_over, host=host))
            while not work.done():
                await asyncio.wait([work], timeout=0.05)
                if self.gate is not gate:
                    work.cancel()
                    if caller and not caller.alive:
                        raise asyncio.CancelledError
                    break
            else:
                return work.result()

    def later(self, api: str, method: str, *params: Any) -> None:
        """What the master tells a node, as its pool of threads does: in order for each node."""
        if api not in self.queues:
            self.queues[api] = asyncio.Queue()
            self.spawn(self._deliver(api))
        self.queues[api].put_nowait((method, params))

    async def _deliver(self, api: str) -> None:
        while True:
            method, params = await self.queues[api].get()
            await asyncio.sleep(self.pause(0.02))
            await self.reach(host_of(api))  # the master's calls have no deadline
            node = self.listening.get(api)
            if node is not None:
                node.take(method, *params)

    def bumped(self, one: Registration, before: str) -> None:
        """The master shuts down a node for another one of its name: may it?"""
        old = self.listening.get(before)
        new = next((p for p in self.pods if p.host == one.host), None)
        if old is None or new is None or self.was_away(host_of(before)):
            return
        ours = old.pod.workload is not None and old.pod.workload == new.workload
        if ours and old.pod is not new and not old.pod.leaving:
            self.broken.append(f"{one.node} at {before} is shut down by {one.api} before its time")
        if ours and old.pod is not new:
            self.broken.append(f"{one.api} gets the name of {before}, which publishes still")

    def heard(self, node: SimNode, topic: str, publishers: list[str]) -> None:
        """A node gets a list of publishers: may it?"""
        bonds = BOND_TOPIC in topic and {host_of(one) for one in publishers} == {node.pod.host}
        may_hear = node.pod.workload is None or bonds
        if (node.name, node.api) not in self.owners and publishers and not may_hear:
            self.broken.append(f"{node.api} waits, and hears {publishers}")
        master = self.master_now
        known = set(master.apis(PUBLISHER, topic)) if master else set()
        for api in set(node.heard.get(topic, ())) - set(publishers):
            if self.was_away(node.pod.host):
                return  # what the master has sent meanwhile comes late
            if api in known and api in self.listening and not self.was_away(host_of(api)):
                self.broken.append(f"{node.api} is told to drop {api} of {topic}, which lives")

    # -- pods --

    def start_pod(
        self,
        workload: str | None,
        names: list[str],
        plans: dict[str, Plan],
        *,
        probed: bool = True,
    ) -> SimPod:
        """Start a pod; `probed`: the kubelet looks at it from time to time."""
        pod = SimPod(f"10.0.{next(self._hosts)}.1", workload)
        self.pods.append(pod)
        for name in names:
            self.start_node(pod, name, plans[name])
        if workload and probed:
            self.spawn(self._probe(pod))
        return pod

    def start_node(self, pod: SimPod, name: str, plan: Plan) -> SimNode:
        node = SimNode(self, pod, name, next(self._ports), plan)
        pod.nodes.append(node)
        self.spawn(node.start())
        return node

    async def _probe(self, pod: SimPod) -> None:
        while any(node.alive for node in pod.nodes):
            await asyncio.sleep(self.pause(2.0))
            await self.describe(pod)

    async def describe(self, pod: SimPod) -> list[Any]:
        await self.reach(pod.host)
        words = ("/probe", pod.host, pod.workload, pod.host)
        return list((await self.call(Call("rigelDescribePod", words), hands_over=True)).result)

    async def is_ready(self, pod: SimPod) -> bool:
        """What the pod's readiness probe finds: each node is registered, or waits and is quiet."""
        waiting = {one[1]: one[2] for one in await self.describe(pod)}
        for node in pod.nodes:
            if not node.alive or len(node.registered) < len(node.plan):
                return False
            if waiting.get(node.api, "quiet") != "quiet":
                return False
            at = (await self.call(Call("lookupNode", (GATE, node.name)))).result
            if node.api not in waiting and at != node.api:
                return False
        return True

    async def hand_over(self, pod: SimPod, seconds: float = 10) -> list[str]:
        """What the stop hook does first: return the names that others have got."""
        await self.reach(pod.host)
        pod.leaving = True
        call = Call("rigelHandOver", ("/stop", str(seconds), pod.host))
        return list((await self.call(call, hands_over=True)).result)

    async def end_pod(self, pod: SimPod) -> None:
        """What the kubelet does: the stop hook, which hands over first, then signals."""
        await self.hand_over(pod)
        for node in pod.nodes:
            if node.alive:
                await node.leave()
        if pod in self.pods:
            self.pods.remove(pod)

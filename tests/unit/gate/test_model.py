"""The gate against a simulated graph, in thousands of random orders: the rules hold in each."""

from __future__ import annotations

import asyncio

import pytest

from rigel_gate.calls import GATE, Call
from rigel_gate.registry import PARAMETER, PUBLISHER, SERVICE, SUBSCRIBER
from tests.support.gate_world import SimNode, SimPod, World, run

PLANS = {
    "/talker": [(PUBLISHER, "/rosout"), (PUBLISHER, "/chatter"), (SERVICE, "/talker/ask")],
    "/listener": [(PUBLISHER, "/rosout"), (SUBSCRIBER, "/chatter"), (PARAMETER, "/rate")],
    "/camera": [(PUBLISHER, "/rosout"), (PUBLISHER, "/image"), (PUBLISHER, "/chatter")],
    "/viewer": [(PUBLISHER, "/rosout"), (SUBSCRIBER, "/image"), (SUBSCRIBER, "/chatter")],
}
WORKLOADS = {"talker": ["/talker"], "listener": ["/listener"], "eyes": ["/camera", "/viewer"]}
#: How many stories are told, and by the slow test.
SEEDS, MANY = 100, 3000


class Story:
    """A few minutes of an application's life, chosen by the seed."""

    def __init__(self, seed: int) -> None:
        self.world = World(seed)
        self.pods: dict[str, SimPod] = {}
        self.rolling: set[str] = set()
        self.is_over = False
        self.excused = 0.0  # until when /talker's service may be away

    async def tell(self) -> None:
        world = self.world
        world.start_gate()
        for workload, names in WORKLOADS.items():
            self.pods[workload] = world.start_pod(workload, names, PLANS)
        world.spawn(self.restart_containers())
        world.spawn(self.look_up())
        steps = [
            self.roll_out,
            self.roll_out,
            self.roll_out,
            self.crash,
            self.restart_master,
            self.restart_gate,
            self.set_parameter,
            self.borrow_a_name,
            self.toggle_publisher,
            self.lose_machine,
        ]
        for _ in range(12):
            await asyncio.sleep(world.pause(2.0))
            world.spawn(world.random.choice(steps)())
        await asyncio.sleep(10)
        self.is_over = True
        await asyncio.sleep(50)
        assert not self.rolling, "a roll-out has not ended"
        await self.check()

    async def restart_containers(self) -> None:
        """What the kubelet does: a node that has ended starts again, at another port."""
        while True:
            await asyncio.sleep(0.5)
            for pod in list(self.world.pods):
                if pod.workload is None or pod.leaving:
                    continue
                for node in [n for n in pod.nodes if not n.alive]:
                    pod.nodes.remove(node)
                    self.world.start_node(pod, node.name, node.plan)

    async def roll_out(self) -> None:
        """What the Deployment's controller does, one pod more than wanted and none fewer."""
        world = self.world
        workload = world.random.choice(sorted(WORKLOADS))
        if workload in self.rolling:
            return
        self.rolling.add(workload)
        new = world.start_pod(workload, WORKLOADS[workload], PLANS)
        fails = world.random.random() < 0.2
        await asyncio.sleep(world.pause(2.0))
        while not fails and not await world.is_ready(new):
            await asyncio.sleep(0.5)
        if fails:
            await world.end_pod(new)
        else:
            old, self.pods[workload] = self.pods[workload], new
            await world.end_pod(old)
        self.rolling.discard(workload)

    async def crash(self) -> None:
        pod = self.world.random.choice(self.world.pods)
        if pod.nodes:
            node = self.world.random.choice(pod.nodes)
            self.excuse(node.name)
            node.end()

    async def restart_master(self) -> None:
        if self.world.master_now:
            self.world.kill_master()
            await asyncio.sleep(self.world.pause(3.0))
            self.world.start_master()

    async def restart_gate(self) -> None:
        if self.world.gate:
            for node in [node for pod in self.world.pods for node in pod.nodes if node.stops]:
                self.excuse(node.name)  # its successor is not registered, and it unregisters
            await self.world.kill_gate()
            await asyncio.sleep(self.world.pause(1.0))
            self.world.start_gate()

    async def set_parameter(self) -> None:
        world = self.world
        key = world.random.choice(["/rate", "/camera/gain", "/camera/size/x", "/camera"])
        value = {"gain": 1} if key == "/camera" else world.random.randrange(100)
        await world.call(Call("setParam", ("/tool", key, value)))

    async def borrow_a_name(self) -> None:
        """A laptop's node of the same name: the younger one wins, as in ROS."""
        world = self.world
        pod = world.start_pod(None, ["/talker"], PLANS)
        [node] = pod.nodes
        for _ in range(30):
            self.excuse("/talker")
            await asyncio.sleep(0.1)
            if node.registered and (node.name, node.api) not in world.owners:
                world.broken.append(f"{node.api} has registered and not got its name")
        pod.leaving = True
        node.end()
        world.pods.remove(pod)

    async def toggle_publisher(self) -> None:
        """A node stops to publish, and starts again."""
        nodes = [node for pod in self.world.pods for node in pod.nodes if node.name == "/camera"]
        node = self.world.random.choice(nodes)
        entry = (PUBLISHER, self.world.random.choice(["/chatter", "/image"]))
        if node.alive and node.registered >= set(node.plan):
            await node.unregister(entry)
            await asyncio.sleep(0.1 + self.world.pause(1.0))
            if node.alive:
                await node.register(*entry)

    async def lose_machine(self) -> None:
        """The network to a pod is away for a while."""
        pod = self.world.random.choice(self.world.pods)
        if pod.workload is None:
            return
        self.world.unreachable.add(pod.host)
        for _ in range(self.world.random.randrange(100)):
            for node in pod.nodes:
                self.excuse(node.name)
            await asyncio.sleep(0.1)
            self.world.lost[pod.host] = self.world.now()
        self.world.unreachable.discard(pod.host)
        await asyncio.sleep(15)
        for node in [node for node in pod.nodes if node.alive and not self.is_known(node)]:
            node.end()  # its name went to another pod, as its probe reports

    def is_known(self, node: SimNode) -> bool:
        """Whether a node has a name or waits for one, or has not come so far."""
        gate = self.world.gate
        return gate is None or not node.registered or gate.state.has_node(node.api)

    def was_displaced(self, node: SimNode) -> bool:
        """Whether another node had its name while its machine was away: it is an orphan then.

        The master could not tell it to end, and it does not know that its registrations are gone.
        """
        owners = [api for name, api in self.world.owners if name == node.name]
        again = node.api in owners and set(owners[owners.index(node.api) :]) != {node.api}
        return again and node.pod.host in self.world.lost

    def excuse(self, name: str) -> None:
        """Something has happened to a node that takes its service away for a moment."""
        if name == "/talker":
            self.excused = self.world.now() + 15

    async def look_up(self) -> None:
        """A client that wants the service all the time: it is there also while its name moves."""
        world, seen = self.world, False
        call = Call("lookupService", ("/tool", "/talker/ask"))
        while not self.is_over:
            await asyncio.sleep(world.pause(0.2))
            found = (await world.call(call)).is_success
            if seen and not found and world.now() > self.excused:
                world.broken.append(f"the service is unknown at {world.now():.3f}")
            seen = seen or found

    async def check(self) -> None:
        world, master = self.world, self.world.master_now
        assert master is not None
        assert world.broken == []
        assert not [line for line in world.log if "error" in line], world.log
        living = [node for pod in world.pods for node in pod.nodes if node.alive]
        assert sorted(node.name for node in living) == sorted(PLANS)
        for node in [node for node in living if not self.was_displaced(node)]:
            for entry in node.plan:
                assert (node.name, node.api) in master.registered.get(entry, []), (node.name, entry)
            for topic, heard in node.heard.items():
                there = {api for api in master.apis(PUBLISHER, topic) if api in world.listening}
                assert there <= set(heard), f"{node.name} does not hear {there - set(heard)}"
            for key, value in node.learnt.items():
                assert value == master.parameters.get(key), (node.name, key)
        assert world.gate is not None
        state = world.gate.state
        assert not state.newcomers
        assert state.parameters.own() == {
            k: v for k, v in master.parameters.tree.items() if k != "run_id"
        }
        known = {(k, n) for k, names in master.registered.items() for n, _ in names}
        assert known == {((o.kind, o.key), o.node) for o in state.registry.all()}
        assert state.leaving <= {pod.host for pod in world.pods}
        answer = await world.call(Call("getSystemState", (GATE,)))
        assert answer.is_success


def tell(seeds: range) -> None:
    for seed in seeds:
        try:
            run(Story(seed).tell)
        except Exception as error:
            raise AssertionError(f"seed {seed}: {error}") from error


@pytest.mark.parametrize("seed", range(0, SEEDS, 25))
def test_the_rules_hold_in_any_order(seed: int) -> None:
    """No node loses its name before its time; in the end everyone is registered and hears all."""
    tell(range(seed, seed + 25))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(SEEDS, MANY, 100))
def test_the_rules_hold_in_very_many_orders(seed: int) -> None:
    """What happens once in a thousand orders is found here."""
    tell(range(seed, seed + 100))

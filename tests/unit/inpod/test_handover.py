"""The keepers' protocol in a simulated world: one pod works, and nothing is lost or done twice."""

from __future__ import annotations

import os
from collections.abc import Callable
from types import ModuleType

import pytest

from tests.support.keepers import DRAIN, ENDLESS, HOLD, STOP, WAIT, WORK, Broken, Pod, World

#: How many random worlds each test goes through; the nightly run goes through more.
WORLDS = int(os.environ.get("RIGEL_TEST_WORLDS", "50"))


@pytest.fixture
def handover(script: Callable[[str], ModuleType]) -> ModuleType:
    """The protocol."""
    return script("handover")


def begin(code: ModuleType, seed: int, *, actions: bool) -> World:
    """Return a world with one pod that works, and clients."""
    world = World(code, seed, actions=actions)
    first = start(world)
    first.node.ready_at = min(first.node.ready_at, 0.9)
    first.node.complete_at, first.node.found_at = 0.0, 2.9
    world.run(3.0)
    world.feed(40.0)
    return world


def start(world: World, blind: float = 0.0) -> Pod:
    """Start another pod."""
    name = f"pod-{len(world.pods)}"
    if blind:
        world.excuse(blind + 2.5)
        world.exact = False
    pod = Pod(world, name, blind)
    world.log(f"{name} starts" + (f", blind for {blind:.1f} s" if blind else ""))
    world.pods.append(pod)
    return pod


def start_soon(world: World) -> Pod:
    """Start another pod that is complete, and known to all, as soon as it is ready."""
    pod = start(world)
    pod.node.complete_at = pod.node.found_at = 0.0
    return pod


def end_replaced(world: World) -> None:
    """End pods as Kubernetes does: the older ones, as soon as the youngest works."""
    living = [pod for pod in world.pods if not pod.killed]
    if living and living[-1].node.mode == WORK and living[-1].node.alive():
        for pod in living[:-1]:
            if not getattr(pod, "ending", False):
                pod.ending = True  # type: ignore[attr-defined]
                world.log(f"{pod.name} is ended")
                pod.event(lambda keeper: keeper.leave(world.now, 2.0))
                world.after(world.chance.uniform(0.0, 1.0), pod.kill)
    world.after(0.2, lambda: end_replaced(world))


def gentle(world: World) -> None:
    """Do what happens without anything broken: updates, short stalls, newcomers that end."""
    chance = world.chance
    for _ in range(chance.randint(1, 4)):
        when = chance.uniform(4.0, 25.0)
        world.at(when, lambda: start(world))
    for _ in range(chance.randint(0, 6)):
        world.at(chance.uniform(4.0, 28.0), lambda: stall(world, chance.uniform(0.05, 0.9)))
    for _ in range(chance.randint(0, 3)):
        world.at(chance.uniform(4.0, 28.0), lambda: crash_waiting(world))
    world.slow = chance.choice([1.0, 1.0, 5.0])


def stall(world: World, seconds: float) -> None:
    """A keeper gets no processor for a while."""
    pod = world.chance.choice(world.pods)
    if seconds > 1.0:
        world.excuse(seconds + 4.0)
        world.exact = False
    world.log(f"{pod.name} stalls for {seconds:.2f} s")
    pod.stalled_until = world.now + seconds


def crash_waiting(world: World) -> None:
    """Something of a pod that does not work and has not worked crashes."""
    found = [p for p in world.pods if not p.killed and p.term == 0 and p.node.mode != WORK]
    if found:
        crash(world, world.chance.choice(found))


def crash(world: World, pod: Pod) -> None:
    """Something of a pod crashes, and is started again."""
    what = world.chance.choice(["crash", "crash_node", "crash_keeper"])
    world.log(f"{pod.name}: {what}, in mode {pod.node.mode}")
    getattr(pod, what)()


def violent(world: World) -> None:
    """Do anything."""
    chance, world.exact = world.chance, False
    gentle(world)

    def cut() -> None:
        one, other = chance.choice(world.pods), chance.choice(world.pods)
        pair = frozenset((one.name, other.name))
        length = chance.uniform(0.1, 8.0)
        if one is not other and pair not in world.cuts:
            world.log(f"cut {sorted(pair)} for {length:.1f} s")
            world.cuts.add(pair)
            world.after(length, lambda: heal(pair))

    def heal(pair: frozenset[str]) -> None:
        world.log(f"healed {sorted(pair)}")
        world.cuts.discard(pair)
        world.excuse(4.0)

    def crash_any() -> None:
        living = [pod for pod in world.pods if not pod.killed]
        world.excuse(2.5)
        if living:
            crash(world, chance.choice(living))

    def kill_any() -> None:
        living = [pod for pod in world.pods if not pod.killed]
        if len(living) > 1:
            pod, what = chance.choice(living), chance.choice(["kill", "kill", "lose"])
            world.log(f"{pod.name}: {what}")
            getattr(pod, what)()

    def leave_any() -> None:
        pod = chance.choice(world.pods)
        if pod is not world.pods[-1] and not pod.killed and pod.keeper:
            world.log(f"{pod.name} leaves")
            pod.event(lambda keeper: keeper.leave(world.now, 1.5))
            world.after(2.0, pod.kill)

    acts: list[Callable[[], object]] = [
        cut,
        cut,
        crash_any,
        crash_any,
        kill_any,
        leave_any,
        lambda: stall(world, chance.uniform(0.5, 5.0)),
        lambda: start(world, chance.choice([0.0, 0.0, 2.5, 5.0])),
    ]
    for _ in range(chance.randint(2, 10)):
        world.at(chance.uniform(3.5, 28.0), chance.choice(acts))


def play(code: ModuleType, seed: int, what: Callable[[World], None]) -> World:
    """Go through one world; a broken promise says what has happened in it."""
    world = begin(code, seed, actions=seed % 3 != 0)
    try:
        end_replaced(world)
        what(world)
        world.run(60.0)
        world.judge()
    except Broken as broken:
        raise AssertionError(f"seed {seed}: {broken}\n" + "\n".join(world.history)) from broken
    return world


@pytest.mark.parametrize("what", [gentle, violent])
def test_one_works_and_nothing_is_lost(handover: ModuleType, what: Callable[[World], None]):
    """Whatever happens, in whatever order, the promises of the protocol hold."""
    late = sum(play(handover, seed, what).late for seed in range(WORLDS))
    assert late <= WORLDS / 10


def test_a_worker_that_is_silent_is_replaced(handover: ModuleType) -> None:
    """When its machine is lost, nothing ends its connections; another one works then."""
    world = begin(handover, 1, actions=False)
    first, second = world.pods[0], start_soon(world)
    world.run(9.0)
    assert second.node.mode == WORK
    world.log(f"the machine of {second.name} is lost")
    second.lose()
    world.run(15.0)
    assert first.node.mode == WORK
    assert first.lines[-1] == f"works, since {second.name} does not answer"


def test_a_keeper_without_processor_time_is_not_lost(handover: ModuleType) -> None:
    """Its kernel keeps the connection, and its node works on."""
    world = begin(handover, 1, actions=False)
    first, second = world.pods[0], start_soon(world)
    world.run(9.0)
    second.stalled_until = 17.0
    for step in range(200):
        world.run(9.0 + step / 20)
        assert first.node.mode != WORK
        assert second.node.mode == WORK


def test_of_two_workers_the_later_one_stays(handover: ModuleType) -> None:
    """After a network that was cut, which is not always the younger pod; then that takes over."""
    world = begin(handover, 1, actions=False)
    first, second = world.pods[0], start_soon(world)
    world.run(9.0)
    line = second.lines[-1]
    assert line.startswith(f"works, took over from {first.name}")
    pair = frozenset((first.name, second.name))
    world.cuts.add(pair)
    world.run(14.0)
    assert (first.node.mode, second.node.mode) == (WORK, WORK)
    world.cuts.discard(pair)
    world.excuse(2.0)
    world.run(20.0)
    assert (first.node.mode, second.node.mode) == (WAIT, WORK) or first.node.mode == STOP
    assert len([one for one in second.lines if one.startswith(line[:26])]) == 2


def test_a_worker_whose_keeper_restarts_goes_on(handover: ModuleType) -> None:
    """Its node works all the time, and the keeper knows its term."""
    world = begin(handover, 1, actions=False)
    (pod,) = world.pods
    term = pod.term
    pod.crash_keeper()
    for step in range(200):
        world.run(3.0 + step / 100)
        assert pod.node.mode == WORK
    assert (pod.runs, pod.keeper.role, pod.keeper.term) == (2, "works", term)


def test_a_goal_without_end_is_not_waited_for_for_ever(handover: ModuleType) -> None:
    """When the time is over the new one works, and says what it gave up."""
    world = World(handover, 1, actions=True)
    first = start(world)
    world.run(5.0)
    world.send("goal", 1, ENDLESS)
    world.run(6.0)
    second = start(world)
    world.run(6.0 + DRAIN)
    assert (first.node.mode, second.node.mode) == (WORK, WAIT)
    world.run(16.0 + DRAIN)
    assert second.node.mode == WORK
    assert f"gave up waiting for 1 goals after {DRAIN:.0f} s" in second.lines[-1]


def test_a_node_that_is_behind_is_waited_for(handover: ModuleType) -> None:
    """It works meanwhile, so nothing is lost."""
    world = World(handover, 1, actions=False)
    first = start_soon(world)
    world.work = 0.05
    world.run(3.0)
    world.feed(15.0)
    world.run(10.0)
    second = start_soon(world)
    world.run(20.0)
    assert len(first.node.queues["topic"]) > 100
    assert (first.node.mode, second.node.mode) == (WORK, HOLD)
    world.run(60.0)
    assert second.node.mode == WORK
    assert list(world.problems()) == []


def test_a_node_that_stands_still_is_not_waited_for(handover: ModuleType) -> None:
    """What it had not taken is lost, and the new one's line says so."""
    world = begin(handover, 1, actions=False)
    world.run(5.0)
    world.work = 1000.0
    second = start_soon(world)
    world.run(25.0)
    assert second.node.mode == WORK
    assert "; after 5 s it had not taken all that arrived" in second.lines[-1]


def test_a_pod_waits_for_all_its_nodes(handover: ModuleType) -> None:
    """One that never becomes fit changes nothing, until the old pod ends."""
    world = begin(handover, 1, actions=False)
    first, second = world.pods[0], start_soon(world)
    asked: list[bool] = []
    second.node.agree = lambda fit: asked.append(fit) or False  # type: ignore[method-assign,func-returns-value]
    world.run(50.0)
    assert True in asked
    assert (first.node.mode, second.node.mode) == (WORK, WAIT)
    first.event(lambda keeper: keeper.leave(world.now, 5.0))
    world.run(55.0)
    assert second.node.mode == WORK


def test_who_is_heard_only_inside_of_a_pod_is_not_waited_for(handover: ModuleType) -> None:
    """Large messages by shared memory do not reach the other pod; what does reach it counts."""
    dropped, known = {"image": {"aa01": 7}}, {"image": 1}
    assert not handover._has_taken({}, dropped, known)
    assert handover._has_taken({}, dropped, known, ("aa",))
    assert not handover._has_taken({}, dropped, known, ("bb",))
    assert not handover._has_taken({"image": {"aa01": 6}}, dropped, known, ("aa",))
    assert handover._has_taken({"image": {"aa01": 7}}, dropped, known, ("aa",))


@pytest.mark.parametrize("pod", [0, 1])
def test_neighbors_in_a_pod_do_not_delay_it(handover: ModuleType, pod: int) -> None:
    """Whom the old node alone may hear is not awaited; the new one's own neighbor is heard."""
    world = begin(handover, 1, actions=False)
    second = start_soon(world)
    world.pods[pod].node.neighbors = ["w"]
    if pod == 0:
        second.node.found_at = 1000.0
    world.run(12.0)
    assert second.node.mode == WORK
    assert "did not find" not in second.lines[-1]


def test_new_versions_of_its_partners_are_not_waited_for_long(handover: ModuleType) -> None:
    """They may wait themselves, for this one; one partner it must have."""
    world = begin(handover, 1, actions=False)
    world.pods[0].node.newcomers = 1
    second = start_soon(world)
    world.run(6.0)
    assert second.node.mode == WAIT
    world.run(16.0)
    assert second.node.mode == WORK
    assert "did not find" not in second.lines[-1]
    alone = begin(handover, 1, actions=False)
    alone.pods[0].node.newcomers = 1
    second = start_soon(alone)
    second.node.survey = lambda: (["node", "late"], dict.fromkeys(("topic", "service", "goal"), 0))
    alone.run(20.0)
    assert second.node.mode == WAIT


def test_a_partner_that_never_finds_it_is_not_waited_for_for_ever(handover: ModuleType) -> None:
    """Such as a publisher whose QoS does not fit any more; the line names what it concerns."""
    world = begin(handover, 1, actions=False)
    second = start(world)
    second.node.found_at = 1000.0
    world.run(30.0)
    assert second.node.mode == WAIT
    world.run(40.0)
    assert second.node.mode == WORK
    line = "in 30 s it did not find all that the other one has: service, topic"
    assert second.lines[-1].endswith(line)

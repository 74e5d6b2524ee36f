"""A deploy that is killed after any of its writes orphans nothing, whatever is done next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.locking import PROCESS, lease_ref, process
from rigel_k8s.release.revisions import history
from rigel_k8s.release.types import Desired, Plan, Revision
from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Killed, Store
from tests.support.manifests import RELEASE, claim, config, desired, make, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, diff, down, rollback

LEASE = lease_ref(RELEASE)
VOLUME = make("PersistentVolume", "v", spec={"capacity": {"storage": "1Mi"}})
IDLE: Mapping[str, Any] = {"replicas": 0}
EMPTY: Desired = desired(create_namespace=True)
#: What is there before, and what the killed deploy wants.
SHAPES: Mapping[str, tuple[Desired, Desired]] = {
    "first": (EMPTY, desired(config("a"), workload(**IDLE))),
    "first with its namespace": (EMPTY, desired(config("a"), create_namespace=True)),
    "nothing changes": (desired(config("a")), desired(config("a"))),
    "only options change": (desired(config("a")), desired(config("a"), options={"x": 1})),
    "a value changes": (desired(config("a", k="1")), desired(config("a", k="2"))),
    "one goes, one comes": (desired(config("a"), config("b")), desired(config("a"), config("c"))),
    "all goes": (desired(config("a"), workload(**IDLE)), desired()),
    "a kind changes": (desired(config("talker")), desired(workload(**IDLE))),
    "a workload changes": (desired(workload(**IDLE)), desired(workload(image="app:2", **IDLE))),
    "a name moves": (
        desired(workload("old", singleton="/talker")),
        desired(workload("new", singleton="/talker")),
    ),
    "a master and its nodes": (
        desired(workload("ros-master", first=True), workload("a")),
        desired(workload("ros-master", "app:2", first=True), workload("b")),
    ),
    "data": (desired(config("a"), claim()), desired(config("b"), claim("more"))),
    "a volume": (desired(config("a")), desired(config("a"), VOLUME)),
    "much of all": (
        desired(*(config(f"c{n}") for n in range(5)), workload("x", **IDLE)),
        desired(*(config(f"c{n}", k="2") for n in range(3, 7)), workload("y", **IDLE)),
    ),
}
PROTECTED = ("PersistentVolumeClaim", "PersistentVolume")


def killed(old: Desired, new: Desired) -> Iterator[tuple[FakeCluster, int]]:
    """Yield clusters on which a deploy of `new` was killed after its first, second, ... write."""
    before = prepared(*([old] if old.objects else []), create=not new.create_namespace)
    yield from killed_in(before, lambda fake: deploy(new, fake, report=Recorder()))


def prepared(*releases: Desired, create: bool = True) -> FakeCluster:
    """Return a cluster on which releases were deployed, one after the other."""
    before = FakeCluster(Store(controllers=Controllers()))
    if create:
        before.create(make("Namespace", "n"))
    for wanted in releases:
        deploy(wanted, before, report=Recorder())
    return before


def killed_in(
    before: FakeCluster, command: Callable[[FakeCluster], object]
) -> Iterator[tuple[FakeCluster, int]]:
    """Yield clusters on which a command was killed after its first, second, ... write."""
    for limit in range(1, 40):
        fake = FakeCluster(before.store.clone())
        fake.store.die_after = limit
        try:
            command(fake)
        except Killed:
            fake.revive()
            bury(fake)
            yield fake, limit
        else:
            return
    raise AssertionError("a command of so many writes")


def bury(fake: FakeCluster) -> None:
    """Make the Lease that the killed process has left one of a process that is gone."""
    if LEASE in fake.objects:
        boot, space, pid, _ = process().split()
        dead = f"{boot} {space} {pid} 0"
        fake.objects[LEASE]["metadata"]["annotations"][PROCESS] = dead


def left(fake: FakeCluster) -> set[ObjectRef]:
    """Return all objects that are there, without what Kubernetes makes of them."""
    fake.settle(10)
    made = ("Namespace", "ReplicaSet", "Pod")
    return {ref for ref in fake.objects if ref.kind not in made}


def without_records(fake: FakeCluster) -> set[ObjectRef]:
    return {ref for ref in left(fake) if ref.kind != "Secret"}


def refs(wanted: Desired) -> set[ObjectRef]:
    found = set()
    for one in wanted.objects:
        meta = one["metadata"]
        names = (meta.get("namespace", ""), meta["name"])
        found.add(ObjectRef(one["apiVersion"], one["kind"], *names))
    return found


def data(*of: Desired) -> set[ObjectRef]:
    """Return what holds data, and stays until somebody asks for its end."""
    return {ref for wanted in of for ref in refs(wanted) if ref.kind in PROTECTED}


@pytest.fixture(params=SHAPES)
def shape(request: pytest.FixtureRequest) -> tuple[Desired, Desired]:
    return SHAPES[request.param]


def test_the_same_deploy_again_sees_it_through(shape: tuple[Desired, Desired]) -> None:
    """Just what it wants is there, once, and the next deploy has nothing to do."""
    old, new = shape
    for fake, limit in killed(old, new):
        last = deploy(new, fake, report=Recorder())
        kept = without_records(fake) - data(old)
        assert kept == refs(new) - data(old), f"killed after write {limit}"
        assert {item.ref for item in last.inventory} == refs(new)
        assert all(fake.objects[item.ref]["metadata"]["uid"] == item.uid for item in last.inventory)
        assert {r.status for r in history(fake, RELEASE)} <= {"good", "superseded", "interrupted"}
        assert diff(new, fake).changes == ()


def test_another_deploy_ends_what_was_begun(shape: tuple[Desired, Desired]) -> None:
    """Neither the old nor the new leaves anything behind but data."""
    third = desired(config("third"))
    for fake, limit in killed(*shape):
        deploy(third, fake, report=Recorder())
        kept = without_records(fake) - data(*shape)
        assert kept == refs(third), f"killed after write {limit}"
        assert "pending" not in {r.status for r in history(fake, RELEASE)}


def test_down_leaves_nothing(shape: tuple[Desired, Desired]) -> None:
    for fake, limit in killed(*shape):
        seen = bool(left(fake))
        plan = down(fake, RELEASE, volumes=True, report=Recorder())
        assert bool(plan.steps or plan.records) == seen, f"killed after write {limit}"
        assert left(fake) == set(), f"killed after write {limit}"


@pytest.mark.parametrize("name", [name for name, (old, _) in SHAPES.items() if old.objects])
def test_a_rollback_goes_back_to_what_was_good(name: str) -> None:
    """As long as the killed deploy has not become good itself."""
    old, new = SHAPES[name]
    for fake, limit in killed(old, new):
        if [r.status for r in history(fake, RELEASE)] != ["good", "pending"]:
            continue
        rollback(fake, RELEASE, report=Recorder())
        kept = without_records(fake) - data(new)
        assert kept == refs(old) - data(new), f"killed after write {limit}"


@pytest.mark.parametrize("number", [None, 1])
def test_a_killed_rollback_is_finished_by_the_next_one(number: int | None) -> None:
    """Also where its own revision is good already, and only its Lease is left."""
    made = [
        desired(config("a", k=k), config(f"only-{k}"), workload(f"w{k}", **IDLE)) for k in "123"
    ]
    target = refs(made[(number or 2) - 1])

    def go_back(fake: FakeCluster) -> Revision:
        return rollback(fake, RELEASE, number, report=Recorder())

    kills = 0
    for fake, limit in killed_in(prepared(*made), go_back):
        begun = len(history(fake, RELEASE)) == 4
        if begun and LEASE in fake.objects:
            kills += 1
            report = Recorder()
            assert rollback(fake, RELEASE, report=report).status == "good"
            assert "was interrupted (revision 4); finishing it" in report.lines[0]
        elif not begun:
            go_back(fake)
        assert without_records(fake) == target, f"killed after write {limit}"
    assert kills >= 6, "its revision, three applies, two prunes, its revision again"


def test_after_a_finished_rollback_the_next_one_goes_further_back() -> None:
    """A rollback that was not interrupted is not taken for one that was."""
    fake = prepared(desired(config("a")), desired(config("b")))
    rollback(fake, RELEASE, report=Recorder())
    rollback(fake, RELEASE, report=Recorder())
    assert without_records(fake) == refs(desired(config("b")))


@pytest.mark.parametrize("volumes", [False, True])
@pytest.mark.parametrize("name", ["data", "a master and its nodes"])
def test_a_killed_down_is_finished_by_the_next_one(volumes: Any, name: str) -> None:
    """It says that there is something as long as there is."""
    objects = SHAPES[name][0].objects
    old = desired(*objects, claim(), workload(**IDLE))
    before = prepared(desired(config("b")), old)

    def take_down(fake: FakeCluster) -> Plan:
        return down(fake, RELEASE, volumes=volumes, report=Recorder())

    for fake, limit in killed_in(before, take_down):
        seen = bool(left(fake) - data(old))
        plan = take_down(fake)
        assert bool(plan.steps or plan.records) >= seen, f"killed after write {limit}"
        assert left(fake) == (set() if volumes else data(old)), f"killed after write {limit}"

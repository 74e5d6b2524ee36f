"""Several parts of one job: looked at together, written in order, or not at all."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import attrs
import pytest

from rigel_k8s.deploy import deploy, look, render
from rigel_k8s.errors import ClusterError, RolloutFailed, UserError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.part import Hooks, Inspection, Look, Part
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.types import DeployOptions, Desired, ReleaseId
from rigel_k8s.system.threads import parallel
from tests.support.clock import leap_when_shown
from tests.support.controllers import Controllers, running, unready
from tests.support.fake_cluster import FakeCluster, make_refusal
from tests.support.manifests import config, workload
from tests.support.recorder import Recorder

GROUP = "lab.example.org"
DEFINITION = {
    "apiVersion": "apiextensions.k8s.io/v1",
    "kind": "CustomResourceDefinition",
    "metadata": {"name": f"cables.{GROUP}"},
    "spec": {
        "group": GROUP,
        "scope": "Namespaced",
        "names": {"kind": "Cable", "plural": "cables"},
        "versions": [{"name": "v1", "served": True}],
    },
}
CABLE = {
    "apiVersion": f"{GROUP}/v1",
    "kind": "Cable",
    "metadata": {"name": "lan", "namespace": "n"},
    "spec": {},
}


@attrs.define
class Inspecting(Hooks):
    """Inspections are noted, and find what the test wants."""

    finds: Callable[[bool], Inspection]
    seen: list[bool] = attrs.field(factory=list)

    def inspect(self, cluster: Any, earlier: Sequence[Look]) -> Inspection:
        early = any(one.writes for one in earlier)
        self.seen.append(early)
        return self.finds(early)


def part(
    name: str,
    *objects: Any,
    rank: Any = "application",
    finds: Callable[[bool], Inspection] = lambda early: Inspection(),
    **more: Any,
) -> Part:
    for made in objects:
        if made["kind"] == "Deployment":  # its pods are those of this release
            made["spec"]["template"]["metadata"]["labels"]["rigel-k8s/release"] = name
    desired = Desired(ReleaseId("n", name), objects)
    return Part(desired=desired, rank=rank, hooks=Inspecting(finds), **more)


@pytest.fixture
def options(report: Recorder) -> DeployOptions:
    return DeployOptions(report=report, timeout=60)


def test_parts_are_written_by_their_rank(fake: FakeCluster, options: DeployOptions) -> None:
    """Pods need the network, and nothing needs the stack."""
    parts = [
        part("stack", config("dashboards"), rank="stack"),
        part("robot", workload()),
        part("net", config("cables"), rank="network"),
    ]
    names = [item["metadata"]["name"] for item in render(parts)]
    assert names == ["cables", "talker", "dashboards"]
    deploy(parts, fake, options)
    applied = [ref.name for verb, ref in fake.writes if isinstance(ref, ObjectRef)]
    assert [name for name in applied if name in names] == names


def test_a_kind_that_an_earlier_part_defines_counts_as_defined(
    fake: FakeCluster, options: DeployOptions
) -> None:
    network, robot = part("net", DEFINITION, rank="network"), part("robot", CABLE)
    with pytest.raises(Refused):
        deploy([part("robot", CABLE)], fake, options)
    assert look([robot, network], fake, options)[1].plan.changes
    assert fake.writes == []
    deploy([robot, network], fake, options)
    assert fake.names("Cable") == {"lan"}


def test_what_an_earlier_part_changes_is_inspected_again(
    fake: FakeCluster, options: DeployOptions
) -> None:
    """What only its presence shows may still refuse the next one."""

    def finds(early: bool) -> Inspection:  # noqa: FBT001
        return Inspection() if early else Inspection((ClusterError("no link"),))

    network, robot = part("net", config(), rank="network"), part("robot", workload(), finds=finds)
    with pytest.raises(ClusterError, match="no link"):
        deploy([network, robot], fake, options)
    assert cast(Inspecting, robot.hooks).seen == [True, False]
    assert fake.names("Deployment") == set()
    fake.calls.clear()
    with pytest.raises(ClusterError, match="no link"):  # the network stays as it is
        deploy([network, robot], fake, options)
    assert fake.writes == []


def test_nothing_is_written_where_one_of_them_is_refused(
    fake: FakeCluster, options: DeployOptions
) -> None:
    """All reasons are one error; the user's mistakes decide the exit code."""

    def refuse(live: Any, dry_run: bool) -> Any:  # noqa: FBT001
        name = live["metadata"].get("name")
        return make_refusal("apply", 422, "Invalid", "no such colour") if name == "c" else None

    fake.store.refuse = refuse
    wrong = Inspection((UserError("the interface is wrong", hint="name another"),))
    parts = [
        part("net", config("cables"), rank="network"),
        part("robot", workload(), finds=lambda early: wrong),
        part("stack", config("c"), rank="stack", needed=False, own=False),
    ]
    with pytest.raises(UserError) as caught:
        deploy(parts, fake, options)
    assert caught.value.message.startswith("2 things keep this job from being deployed; nothing")
    assert "the interface is wrong" in caught.value.details
    assert "    name another" in caught.value.details
    assert any("no such colour" in line for line in caught.value.details)
    assert fake.writes == []


def test_the_failure_of_what_is_not_needed_is_a_warning(
    fake: FakeCluster, options: DeployOptions, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And ends the job where it is what the job is about."""

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        return unready(pod) if "loki" in str(pod["metadata"]["labels"]) else running(pod)

    fake.store.controllers = Controllers(kubelet)
    stack = part("stack", workload("loki"), rank="stack", needed=False)
    leap_when_shown(monkeypatch, report, 61, ("loki", "0 of 1 ready"))
    deploy([part("robot", workload()), stack], fake, options)
    assert any("everything else is deployed" in warning for warning in report.warnings)
    report.states.clear()
    leap_when_shown(monkeypatch, report, 61, ("loki", "0 of 1 ready"))
    with pytest.raises(RolloutFailed):
        deploy([part("stack", workload("loki"), rank="stack")], fake, options)


def test_without_rights_what_others_install_is_left_out(
    fake: FakeCluster, options: DeployOptions, report: Recorder
) -> None:
    """A deployer's job goes on; the administrator's own job does not."""
    fake.store.rules = [{"apiGroups": ["apps"], "resources": ["*"], "verbs": ["*"]}]
    shared = part("stack", config(), rank="stack", own=False, hint="ask an administrator")
    assert look([shared], fake, options) == []
    assert "stack stays as it is; ask an administrator" in report.warnings[0]
    shared.own = True
    with pytest.raises(ClusterError, match="right"):
        look([shared], fake, options)


def test_what_all_share_is_not_waited_for_as_it_was_left(
    fake: FakeCluster, options: DeployOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot does not wait for another machine's collector; an application's own pods it does."""
    shared = part("stack", workload("loki"), shared=True)
    deploy([shared], fake, options)
    fake.store.controllers = Controllers(unready)
    for name in fake.names("Pod"):
        fake.delete(ObjectRef("v1", "Pod", "n", name))
    deploy([shared], fake, options)
    report = Recorder()  # the first deploy may have shown the same
    leap_when_shown(monkeypatch, report, 61, ("loki", "0 of 1 ready"))
    with pytest.raises(RolloutFailed):
        deploy([part("stack", workload("loki"))], fake, attrs.evolve(options, report=report))


def test_what_others_have_installed_is_left_alone(
    fake: FakeCluster, options: DeployOptions
) -> None:
    """Its hooks are called: machines may be left to prove."""
    foreign = part("net", config(), rank="network", foreign=True, unfinished=True)
    [seen] = look([foreign], fake, options)
    assert (seen.found, seen.writes) == (None, True)
    deploy([foreign], fake, options)
    assert fake.writes == []
    assert cast(Inspecting, foreign.hooks).seen == [False, False]


def test_machines_are_inspected_beside_the_dry_runs(
    fake: FakeCluster, options: DeployOptions
) -> None:
    """Both are slow on a network far away: nobody waits for one after the other."""
    both = threading.Barrier(2)

    class Parallel(FakeCluster):
        def parallel(self, function: Any, items: Iterable[Any], *, width: int = 2) -> list[Any]:
            return parallel(function, list(items), width=2)

        def get(self, ref: ObjectRef) -> Any:
            if ref.kind == "Namespace":
                both.wait(20)
            return super().get(ref)

    def finds(early: bool) -> Inspection:  # noqa: FBT001
        both.wait(20)
        return Inspection()

    assert look([part("robot", finds=finds)], Parallel(fake.store), options)  # type: ignore[arg-type]

"""An object is written only onto what the plan saw, whatever comes in between."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ConflictError
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.apply import TRIES
from rigel_k8s.release.revisions import history
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired, ref, workload
from tests.support.releases import deploy, diff, down

OTHER = ReleaseId("n", "other")
C = ref("ConfigMap", "c")


@attrs.define
class Between(FakeCluster):
    """A client that something comes in between of: right before it applies one object."""

    about: ObjectRef = C
    act: Callable[[], Any] = lambda: None

    def apply(self, manifest: Any, *, dry_run: bool = False, **options: Any) -> Any:
        if not dry_run and ref_of(manifest) == self.about:
            act, self.act = self.act, lambda: None
            act()
        return super().apply(manifest, dry_run=dry_run, **options)


def owner(fake: FakeCluster, about: ObjectRef) -> str:
    return str(fake.objects[about]["metadata"]["labels"][RELEASE_LABEL])


def test_a_status_that_changes_meanwhile_costs_no_second_write(
    fake: FakeCluster, report: Any
) -> None:
    """Controllers write at any time: only the UID of an object of ours must be the same."""
    deploy(desired(config(k="1")), fake, report=report)
    controller = fake.as_manager("controller")
    news = {"metadata": {"annotations": {"seen": "yes"}}}
    cluster = Between(fake.store, about=C, act=lambda: controller.patch(C, news))
    fake.calls.clear()
    deploy(desired(config(k="2")), cluster, report=report)
    assert fake.calls.count(("apply", C)) == 1


@attrs.define
class Restless(FakeCluster):
    """A client before whose every write another program changes the object."""

    def apply(self, manifest: Any, *, dry_run: bool = False, **options: Any) -> Any:
        if not dry_run and ref_of(manifest) == C:
            news = {"metadata": {"annotations": {"seen": str(self.store.version)}}}
            self.as_manager("controller").patch(C, news)
        return super().apply(manifest, dry_run=dry_run, **options)


def test_an_adoption_that_always_comes_too_late_ends(fake: FakeCluster, report: Any) -> None:
    """As a conflict, after some tries."""
    fake.as_manager("kubectl").create(config(k="0"))
    with pytest.raises(ConflictError, match="has been modified"):
        deploy(desired(config(k="1")), Restless(fake.store), report=report, adopt=True)
    assert fake.calls.count(("apply", C)) == TRIES


def test_of_two_releases_that_claim_one_name_at_once_one_has_it(
    fake: FakeCluster, report: Any
) -> None:
    """The loser is refused by name, and its `down` leaves the winner's object alone."""
    theirs = Desired(OTHER, (workload("talker"), config("theirs")))
    talker = ref("Deployment", "talker")
    cluster = Between(fake.store, about=talker, act=lambda: deploy(theirs, fake, report=report))
    with pytest.raises(ConflictError, match=r"belongs to another release \(other\)"):
        deploy(desired(workload("talker"), config("ours")), cluster, report=report)
    assert owner(fake, talker) == "other"
    assert [r.status for r in history(fake, RELEASE)] == ["failed"]
    assert [r.status for r in history(fake, OTHER)] == ["good"]
    down(fake, RELEASE, volumes=True, report=report)
    assert talker in fake.objects
    assert ref("ConfigMap", "ours") not in fake.objects


def test_two_releases_that_adopt_one_object_at_once_do_not_share_it(
    fake: FakeCluster, report: Any
) -> None:
    """Its UID stays the same, so its state counts as long as it belongs to no release."""
    fake.as_manager("kubectl").create(config(k="0"))
    theirs = Desired(OTHER, (config(k="theirs"),))
    cluster = Between(
        fake.store, about=C, act=lambda: deploy(theirs, fake, report=report, adopt=True)
    )
    with pytest.raises(ConflictError, match=r"belongs to another release \(other\)"):
        deploy(desired(config(k="ours")), cluster, report=report, adopt=True)
    assert (owner(fake, C), fake.objects[C]["data"]) == ("other", {"k": "theirs"})


@pytest.mark.parametrize("adopt", [False, True])
def test_what_another_tool_makes_meanwhile_is_not_overwritten(
    fake: FakeCluster, report: Any, adopt: Any
) -> None:
    """Not even with --adopt: nobody has seen it in a plan."""
    cluster = Between(
        fake.store, about=C, act=lambda: fake.as_manager("kubectl").create(config(k="theirs"))
    )
    with pytest.raises(ConflictError, match="was made by kubectl during this deploy"):
        deploy(desired(config(k="ours")), cluster, report=report, adopt=adopt)
    assert fake.objects[C]["data"] == {"k": "theirs"}


def test_a_change_does_not_reach_an_object_that_was_made_anew(
    fake: FakeCluster, report: Any
) -> None:
    """A change is for the very object that the plan saw."""
    deploy(desired(config(k="1")), fake, report=report)

    def remake() -> None:
        fake.delete(C)
        fake.as_manager("argo").create(config(k="theirs"))

    cluster = Between(fake.store, act=remake)
    with pytest.raises(ConflictError, match="was made by argo during this deploy"):
        deploy(desired(config(k="2")), cluster, report=report)
    assert fake.objects[C]["data"] == {"k": "theirs"}


def test_an_object_that_is_deleted_meanwhile_is_not_made_anew(
    fake: FakeCluster, report: Any
) -> None:
    """Whoever deleted it wanted that; the next deploy creates it."""
    deploy(desired(config(k="1")), fake, report=report)
    cluster = Between(fake.store, act=lambda: fake.delete(C))
    with pytest.raises(ConflictError, match="was deleted by another program"):
        deploy(desired(config(k="2")), cluster, report=report)
    assert C not in fake.objects
    deploy(desired(config(k="2")), fake, report=report)
    assert fake.objects[C]["data"] == {"k": "2"}


@attrs.define
class Deaf(FakeCluster):
    """A cluster whose answer to the first apply of an object is lost, so that it is sent twice."""

    lost: bool = False

    def apply(self, manifest: Any, *, dry_run: bool = False, **options: Any) -> Any:
        first = super().apply(manifest, dry_run=dry_run, **options)
        if dry_run or self.lost:
            return first
        self.lost = True
        return super().apply(manifest, dry_run=dry_run, **options)


def test_an_object_whose_creation_was_sent_twice_is_ours(fake: FakeCluster, report: Any) -> None:
    """The first request got through, and only its answer did not."""
    cluster = Deaf(fake.store)
    assert deploy(desired(config(k="1")), cluster, report=report).status == "good"
    assert cluster.lost
    assert diff(desired(config(k="1")), fake).changes == ()

"""What happens beside the straight way: others' deploys, interruptions, ends that take long."""

from __future__ import annotations

import base64
import threading
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, Interrupted, RolloutFailed
from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import locking
from rigel_k8s.release.apply import Applier
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.locking import lease_ref
from rigel_k8s.release.revisions import history
from rigel_k8s.release.rollout import standing, wait
from rigel_k8s.release.rollout.patience import Patience
from tests.support.clock import leap_when_shown
from tests.support.controllers import Controllers, crash_status, running, unready
from tests.support.fake_cluster import FakeCluster, Store
from tests.support.manifests import RELEASE, claim, config, desired, make, ref, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, diff, down, make_run, rollback

LEASE = lease_ref(RELEASE)
HOLD = "example.com/hold"


def once(fake: FakeCluster, verb: str, what: ObjectRef, then: Callable[[], object]) -> None:
    """Do something right before a write, the first time."""

    def before(now: str, about: ObjectRef) -> None:
        if (now, about) == (verb, what):
            fake.store.before = lambda verb, ref: None
            then()

    fake.store.before = before


# Others.


def test_a_deploy_that_ended_since_the_look_is_looked_at(fake: Any, report: Recorder) -> None:
    """Its objects are this deploy's to keep or to prune, and its number is taken."""
    other = desired(config("theirs"))
    once(fake, "create", LEASE, lambda: deploy(other, fake, report=report))
    revision = deploy(desired(config("ours")), fake, report=report)
    assert revision.number == 2
    assert fake.names("ConfigMap") == {"ours"}


def test_what_another_deploy_has_done_meanwhile_is_not_done_again(
    fake: Any, report: Recorder
) -> None:
    once(fake, "create", LEASE, lambda: deploy(desired(config()), fake, report=report))
    assert deploy(desired(config()), fake, report=report).number == 1
    assert [r.status for r in history(fake, RELEASE)] == ["good"]


def test_nothing_is_made_where_there_is_no_namespace(report: Recorder) -> None:
    """Only one that the Rigelfile names is created."""
    bare = FakeCluster(Store())
    with pytest.raises(ClusterError, match="there is no namespace n"):
        deploy(desired(config()), bare, report=report)  # type: ignore[arg-type]
    with pytest.raises(ClusterError, match='"n" not found'):
        deploy(desired(), bare, report=report)  # type: ignore[arg-type]
    assert bare.objects == {}
    deploy(desired(config(), create_namespace=True), bare, report=report)  # type: ignore[arg-type]
    assert bare.names("Namespace") == {"n"}


def test_down_takes_only_what_we_have_applied(fake: Any, report: Recorder) -> None:
    """A label can be anybody's: what a controller copied it to, what a person made."""
    deploy(desired(config("ours")), fake, report=report)
    theirs = config("theirs")
    theirs["metadata"]["labels"] = {"rigel-k8s/release": "demo"}
    fake.as_manager("kubectl").create(theirs)
    down(fake, RELEASE, volumes=True, report=report)
    assert fake.names("ConfigMap") == {"theirs"}


@pytest.mark.parametrize("kind", [Forbidden, Refusal])
def test_down_goes_on_where_it_may_not_look(
    fake: Any, report: Recorder, monkeypatch: pytest.MonkeyPatch, kind: type[Refusal]
) -> None:
    """What we may not see we have not made; other errors are errors."""
    deploy(desired(config()), fake, report=report)
    plain = FakeCluster.list

    def list_(self: Any, api_version: str, which: str, *words: Any, **more: Any) -> Any:
        if which == "PersistentVolume":
            raise kind("no")
        return plain(self, api_version, which, *words, **more)

    monkeypatch.setattr(FakeCluster, "list", list_)
    if kind is Forbidden:
        down(fake, RELEASE, volumes=True, report=report)
        assert fake.names("ConfigMap") == set()
    else:
        with pytest.raises(Refusal):
            down(fake, RELEASE, volumes=True, report=report)


# Interruptions.


def test_an_interrupted_revision_has_not_failed(fake: Any, report: Recorder) -> None:
    """The cluster goes on with it, and the next run sees it through."""
    cancel = threading.Event()

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        cancel.set()
        return unready(pod)

    fake.store.controllers = Controllers(kubelet)
    with pytest.raises(Interrupted, match="the cluster continues the roll-out"):
        deploy(desired(workload()), fake, report=report, cancel=cancel)
    assert [r.status for r in history(fake, RELEASE)] == ["interrupted"]
    assert [one.status for one in list_releases(fake, None)] == ["interrupted"]
    assert LEASE not in fake.objects
    fake.store.controllers = Controllers()
    deploy(desired(workload()), fake, report=report)
    assert [r.status for r in history(fake, RELEASE)] == ["interrupted", "good"]


def test_an_interruption_is_heard_between_objects(fake: Any, report: Recorder) -> None:
    cancel = threading.Event()
    once(fake, "apply", ref("ConfigMap", "c"), cancel.set)
    with pytest.raises(Interrupted, match="some are new, some old"):
        deploy(desired(config(), workload()), fake, report=report, cancel=cancel)
    assert fake.names("ConfigMap", "Deployment") == {"c"}


# History.


def test_a_rollback_keeps_secrets_as_they_are(fake: Any, report: Recorder) -> None:
    """They stand in no revision: there is nothing to put them back to, and pods want them."""
    for number in (1, 2):
        secret = make("Secret", "s", stringData={"k": str(number)})
        deploy(desired(config(k=str(number)), secret), fake, report=report)
    rollback(fake, RELEASE, report=report)
    assert fake.objects[ref("ConfigMap", "c")]["data"] == {"k": "1"}
    assert base64.b64decode(fake.objects[ref("Secret", "s")]["data"]["k"]) == b"2"
    fake.delete(ref("Secret", "s"))
    rollback(fake, RELEASE, 2, report=report)
    assert "Secret n/s is missing, and no revision contains it" in report.warnings[-1]


# Order.


def test_what_others_need_goes_last(fake: Any, report: Recorder) -> None:
    objects = [make("ServiceAccount", "a"), config("c"), make("Service", "s", spec={})]
    deploy(desired(workload("w"), *objects), fake, report=report)
    fake.calls.clear()
    deploy(desired(), fake, report=report)
    assert [r.name for verb, r in fake.writes if verb == "delete"][:-1] == ["w", "s", "c", "a"]


def test_a_kind_is_served_before_its_objects_are_applied(fake: Any, report: Recorder) -> None:
    """The API server takes a moment to learn a new kind."""
    definition = {
        "apiVersion": "apiextensions.k8s.io/v1",
        "kind": "CustomResourceDefinition",
        "metadata": {"name": "robots.example.com"},
        "spec": {
            "group": "example.com",
            "scope": "Namespaced",
            "names": {"kind": "Robot", "plural": "robots"},
            "versions": [{"name": "v1", "served": True}],
        },
    }
    robot = {**make("Robot", "r2"), "apiVersion": "example.com/v1"}
    deploy(desired(robot, definition), fake, report=report)
    assert fake.names("Robot") == {"r2"}


def test_an_object_that_is_ending_is_waited_for(fake: Any, report: Recorder) -> None:
    """What is applied to it would end with it."""
    held = config()
    held["metadata"]["finalizers"] = [HOLD]
    deploy(desired(held), fake, report=report)
    fake.delete(ref("ConfigMap", "c"))
    plan = diff(desired(held), fake)
    impatient = Applier(make_run(desired(), fake, report=report, timeout=0.05))
    with pytest.raises(ClusterError, match=r"1 object\(s\) still exist") as caught:
        impatient.apply(plan)
    assert caught.value.details == (f"ConfigMap n/c: {HOLD} holds it",)


def test_down_returns_when_the_data_are_gone(fake: Any, report: Recorder) -> None:
    """Who deploys anew at once must not meet the old data."""
    held = claim()
    held["metadata"]["finalizers"] = ["kubernetes.io/pvc-protection"]
    deploy(desired(held), fake, report=report)
    with pytest.raises(ClusterError, match="still exist") as caught:
        down(fake, RELEASE, volumes=True, report=report, timeout=0.05)
    assert "kubernetes.io/pvc-protection holds it" in caught.value.details[0]


# Causes.


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Looks without pauses; each renewal of the Lease lets the controllers look again."""
    monkeypatch.setattr(wait, "EXPLAIN", 0.0)
    monkeypatch.setattr(wait, "LOOK", 0.01)
    monkeypatch.setattr(wait, "QUIET", 0.0)
    monkeypatch.setattr(locking, "RENEW", 0.05)


def test_what_is_optional_may_crash(
    fake: Any, report: Recorder, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is told, and the release is good without it."""
    leap_when_shown(
        monkeypatch, report, standing.GRACE, ("extra", "exited"), ("talker", "1 of 1 ready")
    )

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        return crash_status(pod) if "extra" in pod["metadata"]["name"] else running(pod)

    fake.store.controllers = Controllers(kubelet)
    extra = workload("extra", **{"rigel-k8s/optional": "true"})
    hasty = Patience(crash=0.0, crash_limit=0.0)
    wanted = desired(workload(), extra)
    assert deploy(wanted, fake, report=report, patience=hasty, timeout=30).status == "good"
    [warning] = report.warnings
    message, log = warning.split("\n")
    assert message.startswith("extra is not ready: container node exited with code 1")
    assert message.endswith("; demo runs without it; `rigel status` shows its state")
    assert log == "    last words"


def unpulled(pod: dict[str, Any]) -> dict[str, Any]:
    """Return the status of a pod whose image cannot be pulled."""
    waits = {"waiting": {"reason": "ErrImagePull", "message": "not found"}}
    image = pod["spec"]["containers"][0]["image"]
    container = {"name": "node", "image": image, "ready": False, "state": waits}
    return {"phase": "Pending", "containerStatuses": [container]}


def test_a_cause_that_lasts_is_told_once_with_its_remedy(
    fake: Any, report: Recorder, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the present state while the deploy waits, and then in the error."""
    cause = "image app:1 cannot be pulled: not found"
    leap_when_shown(monkeypatch, report, Patience().image, ("listener", cause), ("talker", cause))
    fake.store.controllers = Controllers(unpulled)
    wanted = desired(workload("listener"), workload())
    with pytest.raises(RolloutFailed) as caught:
        deploy(wanted, fake, report=report)
    error = caught.value
    assert error.message == f"listener, talker did not become ready: {cause}"
    assert error.details == ()
    remedy = "push it, correct its name, or give the namespace a pull secret"
    assert error.hint == f"{remedy}; `rigel status` shows its state"
    assert ("talker", cause, False) in report.states
    assert report.warnings == []


def test_a_cause_that_passes_is_told(fake: Any, report: Recorder, quick: None) -> None:
    """When it is over: no error will name it."""
    shown = ("talker", "image app:1 cannot be pulled: not found", False)
    fake.store.controllers = Controllers(
        lambda pod: running(pod) if shown in report.states else unpulled(pod)
    )
    deploy(desired(workload()), fake, report=report, timeout=30)
    assert report.warnings == ["talker: image app:1 cannot be pulled: not found"]


def test_an_interruption_tells_the_causes(fake: Any, report: Recorder, quick: None) -> None:
    """The user has perhaps ended the wait because of one."""
    cancel = threading.Event()

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        if any("cannot be pulled" in state for _, state, _ in report.states):
            cancel.set()
        return unpulled(pod)

    fake.store.controllers = Controllers(kubelet)
    with pytest.raises(Interrupted):
        deploy(desired(workload()), fake, report=report, cancel=cancel)
    assert report.warnings == ["talker: image app:1 cannot be pulled: not found"]


def test_what_only_events_tell_is_told(
    fake: Any, report: Recorder, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A volume that cannot be mounted shows nowhere else."""
    leap_when_shown(monkeypatch, report, Patience().mount, ("talker", "FailedMount"))

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        about = {"uid": pod["metadata"]["uid"], "name": pod["metadata"]["name"], "kind": "Pod"}
        words = {"type": "Warning", "reason": "FailedMount", "message": "no such map"}
        event = make("Event", f"e-{pod['metadata']['name']}", involvedObject=about, **words)
        if ref("Event", event["metadata"]["name"]) not in fake.objects:
            fake.store.commit(ref("Event", event["metadata"]["name"]), None, event)
        return {"phase": "Pending"}

    fake.store.controllers = Controllers(kubelet)
    with pytest.raises(RolloutFailed, match="FailedMount: no such map"):
        deploy(desired(workload()), fake, report=report)

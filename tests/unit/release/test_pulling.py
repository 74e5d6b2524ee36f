"""Images of what ends before it is replaced are pulled while it still runs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, PULL_LABEL, RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import pulling
from rigel_k8s.release.revisions import history
from rigel_k8s.release.rollout.patience import Patience
from tests.support.controllers import running
from tests.support.fake_cluster import FakeCluster, Killed
from tests.support.manifests import RELEASE, desired, ref, workload
from tests.support.podsecurity import list_missing
from tests.support.recorder import Recorder
from tests.support.releases import deploy

Live = dict[str, Any]
DIGEST = f"sha256:{'a' * 64}"
NO_IMAGE = 'failed to pull and unpack image "app:2": not found'


def node(name: str = "node1", *images: str, ready: str = "True", **spec: Any) -> Live:
    status = {
        "conditions": [{"type": "Ready", "status": ready}],
        "images": [{"names": list(images)}],
    }
    meta = {"name": name, "labels": {"kubernetes.io/hostname": name}}
    return {"apiVersion": "v1", "kind": "Node", "metadata": meta, "spec": spec, "status": status}


def is_pull(pod: Live) -> bool:
    return PULL_LABEL in (pod["metadata"].get("labels") or {})


def waiting(reason: str, message: str = "") -> Live:
    state = {"waiting": {"reason": reason, "message": message}}
    return {
        "phase": "Pending",
        "containerStatuses": [{"name": "image-0", "image": "app:2", "state": state}],
    }


def pulls_are(fake: FakeCluster, status: Callable[[Live], Live] | Live) -> None:
    """Give pods that pull a status; others are ready."""
    make = status if callable(status) else lambda _: status
    assert fake.store.controllers is not None
    fake.store.controllers.kubelet = lambda pod: make(pod) if is_pull(pod) else running(pod)


@pytest.fixture
def made(fake: FakeCluster) -> list[Live]:
    """The pods that were created to pull."""
    found: list[Live] = []

    def note(live: Live, dry_run: bool) -> None:  # noqa: FBT001 - as a Store calls it
        if live["kind"] == "Pod" and is_pull(live) and not dry_run:
            found.append(live)

    fake.store.refuse = note
    return found


@pytest.fixture
def first(fake: FakeCluster, made: list[Live]) -> Recorder:
    """A release runs on node1, which is ready and has no image."""
    fake.create(node())
    deploy(desired(workload()), fake, report=Recorder())
    assert made == [], "a first deploy pulls nothing before"
    fake.calls.clear()
    return Recorder()


def update(fake: FakeCluster, report: Recorder, *objects: Live, **more: Any) -> None:
    deploy(desired(*(objects or (workload(image="app:2"),))), fake, report=report, **more)


def test_a_new_image_is_pulled_before_anything_is_written(
    fake: FakeCluster, first: Recorder, made: list[Live]
) -> None:
    """On the old pod's machine, and the pod that pulls is gone by then."""
    update(fake, first)
    (pod,) = made
    assert pod["spec"]["nodeName"] == "node1"
    assert [c["image"] for c in pod["spec"]["containers"]] == ["app:2"]
    names = [(verb, one.name) for verb, one in fake.writes if not isinstance(one, str)]
    name = pod["metadata"]["name"]
    assert names[:4] == [
        ("create", "rigel.demo"),
        ("create", name),
        ("delete", name),
        ("create", "rigel.demo.v2"),
    ]
    assert not any(map(is_pull, fake.list("v1", "Pod")))


def test_a_pod_that_pulls_is_no_part_of_the_release_and_harmless(
    fake: FakeCluster, first: Recorder, made: list[Live]
) -> None:
    """It ends by itself, goes with its Deployment, and no Pod Security refuses it."""
    changed = workload(image="app:2")
    spec = changed["spec"]["template"]["spec"]
    spec["tolerations"] = [{"key": "robot", "operator": "Exists"}]
    spec["imagePullSecrets"] = [{"name": "demo-registry"}]
    spec |= {"serviceAccountName": "robot", "hostNetwork": True, "volumes": [{"name": "x"}]}
    update(fake, first, changed)
    (pod,) = made
    own = pod["spec"]
    assert RELEASE_LABEL not in pod["metadata"]["labels"]
    assert "annotations" not in pod["metadata"]
    (owner,) = pod["metadata"]["ownerReferences"]
    assert (owner["kind"], owner["name"]) == ("Deployment", "talker")
    assert own["activeDeadlineSeconds"] > 300
    assert own["restartPolicy"] == "Never"
    for key in ("tolerations", "imagePullSecrets", "serviceAccountName"):
        assert own[key] == spec[key]
    assert not own.keys() & {"hostNetwork", "volumes"}
    assert list_missing(own) == []


class Watcher(Recorder):
    """A user who acts when a state is shown."""

    def __init__(self, act: Callable[[], None]) -> None:
        super().__init__()
        self.act = act

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        super().progress(key, state, done=done)
        if state.startswith("pulls"):
            self.act()


def begin(fake: FakeCluster, pod: Live, reason: str = "Pulling") -> Live:
    """Pull for as long as the test wants, and report that as kubelets do."""
    about = {"uid": pod["metadata"]["uid"], "fieldPath": "spec.containers{image-0}"}
    event = {"apiVersion": "v1", "kind": "Event", "involvedObject": about, "reason": reason}
    name = f"{pod['metadata']['name']}.{reason.lower()}"
    event["metadata"] = {"name": name, "namespace": "n"}
    if ref("Event", name) not in fake.objects:
        fake.store.commit(ref("Event", name), None, event)
    return waiting("ContainerCreating")


@pytest.mark.parametrize("reason", ["RunContainerError", "CreateContainerError"])
def test_the_wait_ends_when_the_image_is_there(
    fake: FakeCluster, first: Recorder, reason: str
) -> None:
    """Its container need not start; a line when the pull begins, and one when it is done."""

    def pull() -> None:
        pulls_are(fake, waiting(reason))
        fake.store.version += 1  # something happens

    report = Watcher(pull)
    pulls_are(fake, lambda pod: begin(fake, pod))
    update(fake, report)
    assert report.states[:2] == [
        ("node1", "pulls app:2 before the update", False),
        ("node1", "has pulled app:2", True),
    ]


def test_the_wait_ends_when_the_kubelet_says_that_the_image_is_there(
    fake: FakeCluster, first: Recorder
) -> None:
    """Its event comes up to a second before the pod's status; another pod's does not count."""

    def pulled(uid: str = "") -> None:
        (pod,) = filter(is_pull, fake.list("v1", "Pod"))
        meta = {**pod["metadata"], "uid": uid or pod["metadata"]["uid"]}
        begin(fake, {**pod, "metadata": meta}, "Pulled")

    pulls_are(fake, lambda pod: begin(fake, pod))
    with pytest.raises(ClusterError, match=r"is not pulled after 0.5 s"):
        update(fake, Watcher(lambda: pulled("another")), timeout=0.5)
    report = Watcher(pulled)
    update(fake, report)
    assert ("node1", "has pulled app:2", True) in report.states


def test_nothing_is_shown_of_an_image_that_is_there(fake: FakeCluster, first: Recorder) -> None:
    """A machine may have more images than it reports."""
    pulls_are(fake, waiting("RunContainerError"))
    update(fake, first)
    assert not [state for state in first.states if "pull" in state[1]]


def test_an_image_that_cannot_be_pulled_leaves_the_old_pod(
    fake: FakeCluster, first: Recorder
) -> None:
    """The cause is as of a roll-out; nothing was written, and no revision failed."""
    before = {one: live for one, live in fake.objects.items() if one.kind in ("Deployment", "Pod")}
    pulls_are(fake, waiting("ErrImagePull", NO_IMAGE))
    with pytest.raises(ClusterError) as caught:
        update(fake, first, patience=Patience(image=0.0))
    assert caught.value.message == (
        "the old version still runs (revision 1); talker on node1 cannot be updated: image app:2"
        " cannot be pulled: not found"
    )
    assert "pull secret; nothing was changed" in (caught.value.hint or "")
    fake.settle()
    after = {one: live for one, live in fake.objects.items() if one.kind in ("Deployment", "Pod")}
    assert after == before
    assert [one.status for one in history(fake, RELEASE)] == ["good"]  # type: ignore[arg-type]


def test_a_registry_that_fails_for_a_moment_does_not_fail_the_update(
    fake: FakeCluster, first: Recorder
) -> None:
    """The kubelet tries again."""
    answers = iter([waiting("ErrImagePull", NO_IMAGE), waiting("RunContainerError")])

    def act(pod: Live) -> Live:
        fake.store.version += 1
        return next(answers, waiting("RunContainerError"))

    pulls_are(fake, act)
    update(fake, first)
    assert [one.status for one in history(fake, RELEASE)] == ["superseded", "good"]  # type: ignore[arg-type]


def test_an_interruption_deletes_what_pulls(fake: FakeCluster, first: Recorder) -> None:
    cancel = threading.Event()
    pulls_are(fake, lambda pod: begin(fake, pod))
    with pytest.raises(Interrupted, match="nothing was changed"):
        update(fake, Watcher(cancel.set), cancel=cancel)
    assert not any(map(is_pull, fake.list("v1", "Pod")))
    assert ref("Secret", "rigel.demo.v2") not in fake.objects


def test_what_a_killed_process_left_is_removed(
    fake: FakeCluster, first: Recorder, made: list[Live]
) -> None:
    """By the next such update, even if the machine has the image by then."""
    fake.store.die_after = 2  # the Lease, the pod
    with pytest.raises(Killed):
        update(fake, first)
    fake.revive()
    fake.store.objects.pop(ref("Lease", "rigel.demo"))  # has expired
    assert len(list(filter(is_pull, fake.list("v1", "Pod")))) == 1
    machine = ObjectRef("v1", "Node", "", "node1")
    fake.objects[machine] |= {"status": node("node1", "docker.io/library/app:2")["status"]}
    update(fake, first)
    assert len(made) == 1
    assert not any(map(is_pull, fake.list("v1", "Pod")))


def test_a_machine_that_does_not_begin_is_not_waited_for(
    fake: FakeCluster, first: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be switched off, or its network broken: the update is as it was without pulls."""
    monkeypatch.setattr(pulling, "BEGIN", 0.0)
    pulls_are(fake, {})
    update(fake, first)
    assert [one.status for one in history(fake, RELEASE)] == ["superseded", "good"]  # type: ignore[arg-type]


def test_a_pull_that_another_program_ends_is_not_waited_for(
    fake: FakeCluster, first: Recorder
) -> None:
    """A drained machine, for example."""

    def drain() -> None:
        (one,) = filter(is_pull, fake.list("v1", "Pod"))
        fake.delete(ref("Pod", one["metadata"]["name"]))

    pulls_are(fake, lambda pod: begin(fake, pod))
    update(fake, Watcher(drain), timeout=10.0)
    assert [one.status for one in history(fake, RELEASE)] == ["superseded", "good"]  # type: ignore[arg-type]


@pytest.mark.parametrize("verb", ["create", "nodes", "watch"])
def test_missing_rights_do_not_prevent_an_update(
    fake: FakeCluster, first: Recorder, made: list[Live], verb: str, monkeypatch: Any
) -> None:
    """Without the right to see machines or events it pulls as well."""
    plain = getattr(FakeCluster, verb)

    def refuse(self: FakeCluster, *words: Any, **more: Any) -> Any:
        about_pull = verb == "create" and is_pull(words[0])
        if about_pull or verb == "nodes" or words[1:2] == ("Event",):
            raise Forbidden("you may not")
        return plain(self, *words, **more)

    monkeypatch.setattr(FakeCluster, verb, refuse)
    update(fake, first)
    assert len(made) == (verb != "create")
    assert first.warnings == []
    assert [one.status for one in history(fake, RELEASE)] == ["superseded", "good"]  # type: ignore[arg-type]


# Which machines pull what.


def step(live: Live, result: Live) -> pulling.Step:
    found = {**live, "metadata": {**live["metadata"], "uid": "w"}}
    return pulling.Step("change", ref("Deployment", "talker"), result, found, result)


def pod(machine: str = "node1", name: str = "talker", ready: str = "True") -> Live:
    meta = {"name": f"{name}-{machine}", "labels": {"app.kubernetes.io/name": name}}
    status = {"conditions": [{"type": "Ready", "status": ready}]}
    return {"metadata": meta, "spec": {"nodeName": machine}, "status": status}


def choose(
    nodes: list[Live] | None,
    *pods: Live,
    image: str = "app:2",
    policy: str = "IfNotPresent",
    **spec: Any,
) -> list[tuple[str, dict[str, str]]]:
    """Return what each machine pulls for an update of talker."""
    result = workload(image=image)
    result["spec"]["template"]["spec"] |= spec
    result["spec"]["template"]["spec"]["containers"][0]["imagePullPolicy"] = policy
    found = pulling.choose([step(workload(), result)], pods or [pod()], nodes)
    return [(one.machine, one.images) for one in found]


PULLS = [("node1", {"app:2": "IfNotPresent"})]


def test_a_machine_pulls_what_it_does_not_report() -> None:
    pinned = f"app:2@{DIGEST}"
    assert choose([node()]) == PULLS
    assert choose([node("node1", "docker.io/library/app:1")]) == PULLS
    assert choose([node("node1", "docker.io/library/app:2")]) == []
    assert choose([node("node1", "docker.io/library/app:2")], image=pinned) != []
    assert choose([node("node1", f"docker.io/library/app@{DIGEST}")], image=pinned) == []


def test_a_pull_policy_decides_as_it_does_for_the_pod() -> None:
    """A tag that may have moved is pulled, a digest never moves."""
    has = node("node1", "docker.io/library/app:2", f"docker.io/library/app@{DIGEST}")
    assert choose([has], policy="Always") == [("node1", {"app:2": "Always"})]
    assert choose([has], policy="Always", image=f"app@{DIGEST}") == []
    assert choose([node()], policy="Never") == []


@pytest.mark.parametrize(
    "changed",
    [
        workload(key="1"),
        workload(image="app:2", **{OPTIONAL_ANNOTATION: "true"}),
        {**workload(image="app:2"), "spec": {**workload(image="app:2")["spec"], "strategy": {}}},
    ],
    ids=["not its image", "optional", "rolling"],
)
def test_only_new_images_of_what_is_needed_and_ends_first_are_pulled(changed: Live) -> None:
    """One that is optional may be without a pod; a rolling one pulls while the old pod works."""
    assert pulling.choose([step(workload(), changed)], [pod()], [node()]) == []


def test_machines_that_cannot_pull_or_run_the_pod_are_left_out() -> None:
    taint = {"key": "robot", "effect": "NoSchedule"}
    assert choose([node(ready="Unknown")]) == []
    assert choose([node("node2")]) == [], "it no longer exists"
    assert choose([node(taints=[taint])]) == []
    assert choose([node(taints=[taint])], tolerations=[{"key": "robot"} | {"value": ""}]) == PULLS
    assert choose([node()], nodeSelector={"kubernetes.io/hostname": "node2"}) == []


def test_without_machines_it_is_tried_where_the_pod_stays() -> None:
    assert choose(None) == PULLS
    assert choose(None, nodeSelector={"kubernetes.io/hostname": "node2"}) == []


def test_only_pods_that_work_count() -> None:
    """Without one there is no gap to shorten; each machine pulls once."""
    nodes = [node("node1"), node("node2"), node("node3")]
    pods = [pod("node1"), pod("node1"), pod("node2", ready="False"), pod("node3", "other")]
    assert choose(nodes, *pods) == PULLS
    assert choose(nodes, {**pod(), "spec": {}}) == [], "on no machine that is known"
    assert [machine for machine, _ in choose(nodes, pod("node3"), pod("node1"))] == [
        "node3",
        "node1",
    ]


def test_workloads_share_the_pull_of_a_machine() -> None:
    """Unless they pull as others."""
    one, other = workload(image="app:2"), workload(image="tool:1")
    steps = [step(workload(), one), step(workload(), other), step(workload(), one)]
    (pull,) = pulling.choose(steps, [pod()], [node()])
    assert list(pull.images) == ["app:2", "tool:1"]
    assert pull.title == "app:2, tool:1"
    other["spec"]["template"]["spec"]["imagePullSecrets"] = [{"name": "x"}]
    assert len(pulling.choose(steps, [pod()], [node()])) == 2

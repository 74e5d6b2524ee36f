"""Readiness of every kind, and why a workload is not ready, from objects as they are stored."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout.causes import Cause, causes, find_last_words, probe_failure
from rigel_k8s.release.rollout.patience import Ledger, Patience
from rigel_k8s.release.rollout.readiness import readiness, readiness_among, readiness_without
from rigel_k8s.release.rollout.standing import Standing
from rigel_k8s.release.rollout.view import find_related, pods_of
from tests.support.manifests import ref

REF = ObjectRef("apps/v1", "Deployment", "n", "talker")
OTHER = ObjectRef("apps/v1", "Deployment", "n", "listener")
THIRD = ObjectRef("apps/v1", "Deployment", "n", "driver")


def live(
    kind: str, status: dict[str, Any], spec: dict[str, Any] | None = None, **meta: Any
) -> dict[str, Any]:
    return {
        "apiVersion": "v1",
        "kind": kind,
        "metadata": {"name": "x", "uid": "u", "generation": 2, **meta},
        "spec": spec or {},
        "status": status,
    }


SEEN = {"observedGeneration": 2}
FULL = {**SEEN, "replicas": 1, "updatedReplicas": 1, "availableReplicas": 1}
UNBOUND = "pod has unbound immediate PersistentVolumeClaims"


@pytest.mark.parametrize(
    ("kind", "status", "spec", "done", "ok"),
    [
        ("Deployment", FULL, {"replicas": 1}, True, True),
        ("Deployment", {**FULL, "observedGeneration": 1}, {}, False, True),
        ("Deployment", {}, {"replicas": 0}, False, True),
        ("Deployment", {**FULL, "updatedReplicas": 0}, {}, False, True),
        ("Deployment", {**FULL, "replicas": 2}, {}, False, True),
        ("Deployment", {**FULL, "availableReplicas": 0}, {}, False, True),
        ("Deployment", SEEN, {"replicas": 0}, True, True),
        ("StatefulSet", {**SEEN, "readyReplicas": 2, "updatedReplicas": 2}, {"replicas": 2}, 1, 1),
        ("StatefulSet", {**SEEN, "readyReplicas": 2, "updatedReplicas": 1}, {"replicas": 2}, 0, 1),
        ("StatefulSet", {**SEEN, "readyReplicas": 1, "updatedReplicas": 2}, {"replicas": 2}, 0, 1),
        (
            "StatefulSet",
            {**SEEN, "readyReplicas": 1, "updatedReplicas": 1, "availableReplicas": 0},
            {"minReadySeconds": 1},
            False,
            True,
        ),
        (
            "DaemonSet",
            {
                **SEEN,
                "desiredNumberScheduled": 2,
                "updatedNumberScheduled": 2,
                "numberAvailable": 2,
            },
            {},
            True,
            True,
        ),
        ("DaemonSet", {**SEEN, "desiredNumberScheduled": 2}, {}, False, True),
        ("Job", {"conditions": [{"type": "Complete", "status": "True"}]}, {}, True, True),
        ("Job", {"conditions": [{"type": "Failed", "status": "True"}]}, {}, True, False),
        ("Job", {"active": 1}, {}, False, True),
        ("Pod", {"phase": "Running"}, {}, False, True),
        (
            "Pod",
            {"phase": "Running", "conditions": [{"type": "Ready", "status": "True"}]},
            {},
            True,
            True,
        ),
        ("Pod", {"phase": "Failed", "reason": "Evicted"}, {}, True, False),
        ("PersistentVolumeClaim", {"phase": "Bound"}, {}, True, True),
        ("PersistentVolumeClaim", {"phase": "Pending"}, {}, False, True),
        ("PersistentVolumeClaim", {"phase": "Lost"}, {}, True, False),
        ("PersistentVolume", {"phase": "Available"}, {}, True, True),
        ("PersistentVolume", {"phase": "Released"}, {}, True, False),
        ("Service", {}, {}, True, True),
        ("NetworkAttachmentDefinition", {}, {}, True, True),
        ("Robot", {"conditions": [{"type": "Ready", "status": "False"}]}, {}, False, True),
        ("Robot", {"observedGeneration": 1}, {}, False, True),
    ],
)
def test_readiness(
    kind: str, status: dict[str, Any], spec: dict[str, Any], done: object, ok: object
) -> None:
    """One line for each state that a kind can be in."""
    found = readiness(live(kind, status, spec))
    assert (found.done, found.ok) == (bool(done), bool(ok))


@pytest.mark.parametrize(("there", "words"), [(0, "0 of 2 pods exist"), (2, "0 of 2 pods are new")])
def test_pods_are_new_only_beside_old_ones(there: int, words: str) -> None:
    """A first deploy has none."""
    status = {**SEEN, "replicas": there, "updatedReplicas": 0}
    assert readiness(live("Deployment", status, {"replicas": 2})).message == words


def test_what_is_being_deleted_is_not_ready() -> None:
    """Whatever its status still says."""
    assert not readiness(live("Deployment", FULL, deletionTimestamp="now")).done


def pod(name: str = "p", owner: str = "rs2", **status: Any) -> dict[str, Any]:
    reference = {"controller": True, "uid": owner}
    return live("Pod", status, name=name, uid=f"uid-{name}", ownerReferences=[reference])


def container(state: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"containerStatuses": [{"name": "c", "image": "i:1", "state": state, **more}]}


def waiting(reason: str, message: str = "") -> dict[str, Any]:
    return {"waiting": {"reason": reason, "message": message}}


def ended(code: int, reason: str = "Error", message: str = "") -> dict[str, Any]:
    return {"terminated": {"exitCode": code, "reason": reason, "message": message}}


def test_a_program_that_cannot_be_started_has_one_cause() -> None:
    """The runtime tries again and again: otherwise two causes would take turns."""
    why = 'exec: "/bin/x": no such file'
    states = [
        container(waiting("RunContainerError", why)),
        container(ended(128, "StartError", why)),
        container(waiting("CrashLoopBackOff"), lastState=ended(128, "StartError", why)),
    ]
    found = {causes(live("Deployment", {}), [pod(**status)], [])[0] for status in states}
    assert [(one.kind, one.message) for one in found] == [
        ("start", f"container c cannot be started: {why}")
    ]
    again = container({"running": {}}, lastState=ended(128, "StartError", why), restartCount=1)
    assert causes(live("Deployment", {}), [pod(**again)], [])[0].kind == "restarted"


TRACEBACK = """[INFO] [1.5] [driver]: starting
Traceback (most recent call last):
  File "/ws/install/rover/lib/rover/driver", line 33, in <module>
    sys.exit(load_entry_point('rover', 'console_scripts', 'driver')())
  File "/ws/install/rover/lib/python3.12/site-packages/rover/driver.py", line 24, in main
    node.declare_parameter("scale", 1.0)
  File "/opt/ros/jazzy/lib/python3.12/site-packages/rclpy/node.py", line 584, in _declare
    raise InvalidParameterTypeException(
    ^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^^
rclpy.exceptions.InvalidParameterTypeException: Trying to set parameter 'scale' to 'two'
[ros2run]: Process exited with failure 1
"""


def test_the_last_words_of_python_are_its_error() -> None:
    """With the place in the user's own file; also where the log's end begins inside of it."""
    error = (
        "rclpy.exceptions.InvalidParameterTypeException: Trying to set parameter 'scale' to 'two'"
    )
    place = "/ws/install/rover/lib/python3.12/site-packages/rover/driver.py:24"
    assert find_last_words(TRACEBACK) == f"{error}, {place}"
    assert find_last_words(TRACEBACK[TRACEBACK.index("scale") :]) == error
    cut = TRACEBACK[: TRACEBACK.index("rclpy.exceptions")]
    assert find_last_words(cut).startswith("…")


@pytest.mark.parametrize("place", ["rmw.sh: 49: exec: ", "rmw.sh: line 49: ", ""])
def test_a_program_that_does_not_exist_is_named_without_our_script(place: str) -> None:
    """Each shell words it differently; where our line is helps nobody."""
    line = (
        f"/rigel-k8s/{place}/robot/planer.py: not found" if place else "/robot/planer.py: not found"
    )
    assert find_last_words(f"{line}\n") == "/robot/planer.py: not found"


@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("1\nbash: line 1: planner: command not found\n2\n", "planner: command not found"),
        ("[rosrun] You have chosen a non-unique executable, please pick one:\n1) /b\n2) /a\n#? \n",
         "non-unique executable, please pick one:"),
        ("[ERROR] no map\nbye\n[ERROR] no map\n", "[ERROR] no map"),
        ("[INFO] [1.5]: 0 errors\ndefault\n", "[INFO] [1.5]: 0 errors default"),
    ],
)  # fmt: skip
def test_the_last_words_are_the_errors_among_them(log: str, words: str) -> None:
    """Whatever was printed around them, and in which order."""
    assert find_last_words(log).endswith(words)


@pytest.mark.parametrize(
    ("log", "words"),
    [
        ('Error: cannot start pipelines: cannot start "otlp_http" exporter: timeout\n',
         "another collector uses the same directory"),
        ("panic: assertion failed: Page expected to be: 5, but self identifies as 0\n\n"
         "goroutine 24 [running]:\ngo.etcd.io/bbolt.(*Tx).page(0x39804c3a3630?)\n",
         "its files are damaged"),
    ],
)  # fmt: skip
def test_what_the_collector_prints_is_said_in_words(log: str, words: str) -> None:
    assert find_last_words(log).startswith(words)


@pytest.mark.parametrize(
    ("status", "kind", "words"),
    [
        (container(waiting("ErrImagePull", 'rpc: "i:1": not found')), "image", "pulled: not found"),
        (container(waiting("ImagePullBackOff", "Back-off")), "image", "pulled: Back-off"),
        (container(waiting("InvalidImageName", "bad")), "image-name", "invalid image name"),
        (container(waiting("CreateContainerConfigError", "no x")), "start", "no x"),
        (container(ended(3)), "crash", "exited with code 3"),
        (container(ended(3, message="no package\nnav\n")), "crash", "code 3 (no package nav)"),
        (container(ended(139)), "crash", "killed by signal 11"),
        (container(ended(137, "OOMKilled")), "crash", "ran out of memory"),
        (
            container(waiting("CrashLoopBackOff"), lastState=ended(0, "Completed"), restartCount=4),
            "crash",
            "exited with code 0",
        ),
        (
            container({"running": {}}, lastState=ended(1), restartCount=1),
            "restarted",
            "exited with code 1",
        ),
        ({"phase": "Failed", "reason": "Evicted", "message": "disk"}, "evicted", "disk"),
        (
            {"conditions": [{"type": "PodScheduled", "status": "False", "message": "0/2 nodes"}]},
            "unschedulable",
            "no machine can run the pod: 0/2 nodes",
        ),
        (
            {"conditions": [{"type": "PodScheduled", "status": "False", "message": UNBOUND}]},
            "claim",
            "a claim has no volume",
        ),
    ],
)
def test_a_pod_tells_its_cause(status: dict[str, Any], kind: str, words: str) -> None:
    """Waiting reasons, exits, conditions."""
    [found] = causes(live("Deployment", {}), [pod(**status)], [])
    assert found.kind == kind
    assert words in found.message


def test_a_crash_is_known_again_without_its_last_words() -> None:
    [found] = causes(live("Deployment", {}), [pod(**container(ended(3, message="no map")))], [])
    assert found.message == f"{found.brief} (no map)"


@pytest.mark.parametrize(
    "status",
    [
        container({"running": {}}),
        container({"running": {}}, ready=True, lastState=ended(1), restartCount=3),
        container(waiting("ContainerCreating")),
        container(ended(0, "Completed")),
    ],
)
def test_nothing_is_wrong_with_a_pod_on_its_way(status: dict[str, Any]) -> None:
    """Starting, running, ready again."""
    assert causes(live("Deployment", {}), [pod(**status)], []) == []


def test_an_old_pod_on_a_lost_machine_is_why_no_new_one_starts() -> None:
    """It counts only where no other pod lives: where one does, that has its place."""
    lost = [{"type": "Ready", "status": "False"}, {"type": "ContainersReady", "status": "True"}]
    old = pod("old", conditions=lost)
    old["spec"]["nodeName"] = "robot-1"
    old["metadata"]["deletionTimestamp"] = "2026-01-01T00:00:00Z"
    [found] = causes(live("Deployment", {}), [old], [])
    assert (found.kind, found.pod) == ("away", "old")
    assert "robot-1" in found.message
    assert causes(live("Deployment", {}), [old, pod("new")], []) == []
    assert list(ledger_of(found).find_hopeless(1e6)) == []  # a robot comes back when it does


def ledger_of(cause: Cause) -> Ledger:
    """Return a ledger that has seen a cause at its beginning."""
    made = Ledger(Patience())
    made.note(0.0, [(REF, cause)])
    return made


def event(uid: str, reason: str, message: str, time: str = "1") -> dict[str, Any]:
    about = {"uid": uid}
    return {"involvedObject": about, "reason": reason, "message": message, "lastTimestamp": time}


def test_events_tell_mounts_only_until_a_container_has_started() -> None:
    """A late event about an early failure is no cause any more."""
    events = [event("uid-p", "FailedMount", "no such file")]
    [found] = causes(live("Deployment", {}), [pod(**container(waiting("x")))], events)
    assert (found.kind, found.message) == ("mount", "FailedMount: no such file")
    running = pod(**container({"running": {}}, started=False))  # its startup probe still fails
    assert causes(live("Deployment", {}), [running], events) == []
    pulls = pod(**container(waiting("ErrImagePull", "no such image")))
    assert [one.kind for one in causes(live("Deployment", {}), [pulls], events)] == ["image"]


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        (": /dev/a is not a character device", "/dev/a is not a character device"),
        (": /a is not a file, it's a directory", "/a is not a file: it's a directory"),
        (
            ', /a is not a directory, unable to determine its type: path "/a" does not exist',
            '/a is not a directory: path "/a" does not exist',
        ),
    ],
)
def test_a_path_that_its_machine_lacks_is_named_with_the_machine(said: str, shown: str) -> None:
    """In the words of old and new kubelets."""
    told = f'MountVolume.SetUp failed for volume "d" : hostPath type check failed{said}'
    waits = pod(**container(waiting("x")))
    waits["spec"] = {"nodeName": "robot-1"}
    [found] = causes(live("Deployment", {}), [waits], [event("uid-p", "FailedMount", told)])
    assert (found.kind, found.message) == ("path", f"on the machine robot-1, {shown}")


def test_an_image_of_two_containers_is_one_cause() -> None:
    """The gate and roscore have one image: a sentence is printed once."""
    pulls = {"image": "robot:1", "state": waiting("ErrImagePull", "no such image")}
    both = [
        {"name": name, "ready": False, "restartCount": 0, **pulls} for name in ("master", "gate")
    ]
    found = causes(live("Deployment", {}), [pod(containerStatuses=both)], [])
    assert [cause.message for cause in found] == ["image robot:1 cannot be pulled: no such image"]


@pytest.mark.parametrize("kind", ["configmap", "secret"])
def test_a_busy_kubelet_is_no_cause(kind: str) -> None:
    """It has not read the pod's ConfigMaps yet, and tries again by itself."""
    busy = f'MountVolume.SetUp failed for volume "x" : failed to sync {kind} cache: timed out'
    creating = [pod(**container(waiting("ContainerCreating")))]
    assert causes(live("Deployment", {}), creating, [event("uid-p", "FailedMount", busy)]) == []
    missing = f'MountVolume.SetUp failed for volume "x" : {kind} "x" not found'
    events = [event("uid-p", "FailedMount", missing)]
    assert [one.kind for one in causes(live("Deployment", {}), creating, events)] == ["mount"]


def test_the_last_probe_failure_is_the_reason() -> None:
    """On one line, though a script wrote several."""
    events = [
        event("uid-p", "Unhealthy", "Readiness probe failed:\nold", "1"),
        event("uid-p", "Unhealthy", "Readiness probe failed:\nno master", "2"),
        event("other", "Unhealthy", "not ours", "3"),
    ]
    assert probe_failure(pod(), events) == "Readiness probe failed: no master"
    assert probe_failure(pod(), []) == ""
    not_run = "Readiness probe errored and resulted in unknown state: rpc error: code = Unknown"
    later = event("uid-p", "Unhealthy", not_run, "3")
    assert probe_failure(pod(), [later, *events]) == "Readiness probe failed: no master"
    assert probe_failure(pod(), [later]) == not_run


def test_the_events_of_a_claim_tell_why_it_has_no_volume() -> None:
    """Its pod shows only that it waits for one."""
    text = "0/1 nodes are available: pod has unbound immediate PersistentVolumeClaims."
    waits = pod(conditions=[{"type": "PodScheduled", "status": "False", "message": text}])
    waits["spec"]["volumes"] = [{"name": "d", "persistentVolumeClaim": {"claimName": "data"}}]
    about = {"kind": "PersistentVolumeClaim", "name": "data", "uid": "uid-c"}
    words = event("", "ProvisioningFailed", 'storageclass "x" not found')
    related = find_related([], [waits], [{**words, "involvedObject": about}])
    [found] = causes(live("Deployment", {}), [waits], related.list_events(waits))
    message = 'claim data has no volume: storageclass "x" not found'
    assert (found.kind, found.message) == ("claim", message)


def test_a_quota_is_in_the_deployments_condition_or_the_owners_events() -> None:
    """No pod shows up."""
    failing = {"type": "ReplicaFailure", "status": "True", "message": "exceeded quota"}
    [found] = causes(live("Deployment", {"conditions": [failing]}), [], [])
    assert found.kind == "quota"
    events = [event("u", "FailedCreate", "exceeded quota")]
    [found] = causes(live("StatefulSet", {}), [], events)
    assert found.kind == "quota"


def test_only_pods_of_the_newest_template_count() -> None:
    """An old pod that crashes on its way out says nothing about the update."""
    number = {"deployment.kubernetes.io/revision": "2"}
    deployment = live("Deployment", {}, annotations=number)
    ours = [{"controller": True, "uid": "u"}]
    sets = [
        live(
            "ReplicaSet",
            {},
            uid=f"rs{n}",
            ownerReferences=ours,
            annotations={"deployment.kubernetes.io/revision": n},
        )
        for n in ("1", "2")
    ]
    found = pods_of(deployment, sets, [pod("old", "rs1"), pod("new", "rs2")])
    assert [p["metadata"]["name"] for p in found] == ["new"]


def test_the_pods_of_a_recreate_deployment_are_old_until_its_controller_makes_new_ones() -> None:
    """It gives the Deployment its next number when the old pods have ended."""
    number = {"deployment.kubernetes.io/revision": "1"}
    ours = [{"controller": True, "uid": "u"}]

    def template(image: str, **labels: str) -> dict[str, Any]:
        return {"template": {"metadata": {"labels": labels}, "spec": {"image": image}}}

    old = template("a", app="x", **{"pod-template-hash": "1"})
    sets = [live("ReplicaSet", {}, old, uid="rs1", ownerReferences=ours, annotations=number)]
    crashed = pod("old", "rs1", **container(ended(127)))
    same = live("Deployment", {}, template("a", app="x"), annotations=number)
    assert pods_of(same, sets, [crashed]) == [crashed]
    changed = live("Deployment", {}, template("b", app="x"), annotations=number)
    assert pods_of(changed, sets, [crashed]) == []


def test_a_crash_counts_when_the_controller_has_seen_the_change() -> None:
    """Until then, what is newest in a StatefulSet's status is the old version."""
    one = ref("StatefulSet", "x")
    labels = {"controller-revision-hash": "1"}
    crashed = pod("x-0", "u", **container(ended(127)))
    crashed["metadata"]["labels"] = labels
    related = find_related([], [crashed])

    def look(seen: int) -> list[str]:
        status = {"observedGeneration": seen, "updateRevision": "1"}
        there = live("StatefulSet", status)
        standing = Standing({one: there})
        standing.rolling.add(one)
        standing.look({one: there}, related, 1.0)
        return [cause.kind for _, cause in standing.find_causes()] + [*map(str, standing.unsteady)]

    assert look(1) == []
    assert look(2) == ["crash", str(one)]


def test_an_old_version_that_was_never_ready_does_not_run() -> None:
    """A Deployment's status counts the ready pods of all versions together."""
    deployment = live("Deployment", {**FULL, "replicas": 2})
    ready = {"conditions": [{"type": "Ready", "status": "True"}]}
    new = pod("new", **ready)
    state = readiness_among(deployment, [new], [new, pod("old", **container(ended(127)))])
    assert (state.message, state.old_runs) == ("1 of 1 new pod ready", False)
    state = readiness_among(deployment, [pod("new")], [pod("new"), pod("old", **ready)])
    assert state.message == "0 of 1 new pod ready, the old version still runs"


def on(node: str, template: str = "2", *, ready: bool = True, **meta: Any) -> dict[str, Any]:
    """Return a DaemonSet's pod on a node."""
    status = {"conditions": [{"type": "Ready", "status": str(ready)}]}
    labels = {"pod-template-generation": template}
    owners = [{"uid": "u", "controller": True}]
    return {
        "metadata": {"name": node, "labels": labels, "ownerReferences": owners, **meta},
        "spec": {"nodeName": node},
        "status": status,
    }


ENDING = {"deletionTimestamp": "now"}


@pytest.mark.parametrize(
    ("pods", "done"),
    [
        ([on("a"), on("b"), on("off", ready=False)], True),
        ([on("a"), on("b"), on("off", "1", ready=False, **ENDING)], True),
        ([on("a"), on("b", ready=False), on("off", ready=False)], False),
        ([on("a"), on("b", "1"), on("off")], False),
        ([on("a"), on("off")], False),
        ([on("a"), on("b", **ENDING), on("off")], False),
        ([on("a"), on("b")], False),
    ],
    ids=["off", "off and old", "unready", "old", "missing", "ending", "another one is missing"],
)
def test_pods_on_nodes_that_are_away_are_not_waited_for(
    pods: list[dict[str, Any]], *, done: bool
) -> None:
    """Every other node has a new pod that is ready; without such nodes nothing is left out."""
    status = {**SEEN, "desiredNumberScheduled": 3, "updatedNumberScheduled": 1}
    notes = {"deprecated.daemonset.template.generation": "2"}
    daemons = live("DaemonSet", status, annotations=notes)
    newest = pods_of(daemons, [], pods)
    assert readiness_without(daemons, newest, pods, {"off"}).done is done
    assert not readiness_without(daemons, newest, pods, set()).done


def test_a_pod_that_only_runs_on_a_node_that_is_away_is_not_waited_for() -> None:
    """Its old pod cannot end there, so that the new one cannot start; a new one that comes is."""
    status = {**SEEN, "replicas": 1, "updatedReplicas": 0}
    deployment = live("Deployment", status, {"replicas": 1})
    old, new = on("off", ready=False), on("a", ready=False)
    assert readiness_without(deployment, [], [old], {"off"}).done
    assert not readiness_without(deployment, [new], [old, new], {"off"}).done
    assert not readiness_without(live("Deployment", {}), [], [old], {"off"}).done
    ending = live("Deployment", status, {"replicas": 1}, **ENDING)
    assert not readiness_without(ending, [], [old], {"off"}).done


def crash(kind: str = "crash") -> Cause:
    return Cause(kind, "exited", "p", "c")


def test_a_cause_is_new_once_and_hopeless_after_its_time() -> None:
    """Told at once, given up later; one that goes away and comes back starts anew."""
    ledger = Ledger(Patience(image=15))
    image = Cause("image", "not found")
    [seen], passed = ledger.note(0, [(REF, image)])
    assert passed == []
    assert ledger.note(10, [(REF, image)]) == ([], [])
    assert list(ledger.find_hopeless(14)) == []
    assert [seen.ref for seen in ledger.find_hopeless(15)] == [REF]
    assert ledger.note(20, []) == ([], [seen])
    fresh, _ = ledger.note(21, [(REF, image)])
    assert len(fresh) == 1
    assert list(ledger.find_hopeless(30)) == []


def test_a_crash_has_time_while_others_are_on_their_way() -> None:
    """A node that ends without a master is not given up before the master is up."""
    ledger = Ledger(Patience(crash=20, crash_limit=120))
    for now in range(0, 100, 10):
        ledger.note(now, [(REF, crash())], coming=[THIRD])
        assert list(ledger.find_hopeless(now)) == []
    ledger.note(111, [(REF, crash())])
    assert len(list(ledger.find_hopeless(111))) == 1
    for now in range(112, 121):
        ledger.note(now, [(REF, crash()), (OTHER, crash())], coming=[THIRD])
    assert [seen.ref for seen in ledger.find_hopeless(120)] == [REF]


@pytest.mark.parametrize(
    ("words", "kind", "third", "limit"),
    [
        ("ended (no map)", "crash", False, 30),
        ("ended (no disk)", "crash", False, 45),  # by itself it may be what the first one needs
        ("ended", "crash", False, 45),  # an exit code does not say that it is the same
        ("ended (no map)", "restarted", False, 45),  # it runs at the moment
        ("ended (no map)", "crash", True, 45),  # the third one has not ended
    ],
)
def test_what_ends_alike_was_not_waited_for(
    words: str,
    kind: str,
    third: bool,  # noqa: FBT001
    limit: int,
) -> None:
    """Of nodes with one mistake, the last one that starts gives the others no new time."""
    ledger = Ledger(Patience(crash=20, crash_limit=120))
    first = Cause(
        "crash", "ended" if words == "ended" else "ended (no map)", "p", "c", True, "ended"
    )
    for now in range(26):
        ledger.note(now, [(REF, first)], coming=[OTHER, THIRD] if third else [OTHER])
        assert list(ledger.find_hopeless(now)) == []
    other = Cause(kind, words, "q", "c", brief="ended")
    for now in range(30, limit + 1, 5):
        ledger.note(now, [(REF, first), (OTHER, other)])
        assert [seen.ref for seen in ledger.find_hopeless(now)] == ([REF] if now == limit else [])


def test_a_container_that_runs_at_the_moment_is_not_given_up() -> None:
    """It was restarted and may get ready; ended again it counts from its first end."""
    ledger = Ledger(Patience(crash=20))
    ledger.note(0, [(REF, crash())])
    ledger.note(30, [(REF, crash("restarted"))])
    assert list(ledger.find_hopeless(30)) == []
    ledger.note(35, [], unsteady={REF})
    assert list(ledger.find_hopeless(35)) == []
    assert ledger.note(40, [(REF, crash())]) == ([], [])
    assert len(list(ledger.find_hopeless(40))) == 1

"""What runs beside an API server, in small steps: Deployments with their pods, and the rest.

One `step` is one look of every controller, so that tests see what is in between: a pod is made,
then starts, then is ready; one that is deleted takes `ending` steps to go.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s.kube.resources import Resource
from rigel_k8s.objects.refs import ObjectRef, ref_of

from .fields import clone

if TYPE_CHECKING:
    from .fake_cluster import Store

Live = dict[str, Any]
REVISION = "deployment.kubernetes.io/revision"
MADE_FOR = "fake/deployment"  # the name of the Deployment that a pod is of


def running(pod: Live) -> Live:
    """Return the status of a pod that is well."""
    return {
        "phase": "Running",
        "podIP": "10.0.0.1",
        "conditions": [{"type": "Ready", "status": "True"}],
        "containerStatuses": [state(name, ready=True) for name in containers(pod)],
    }


def unready(pod: Live) -> Live:
    """Return the status of a pod that runs and never becomes ready."""
    return {
        "phase": "Running",
        "conditions": [{"type": "Ready", "status": "False"}],
        "containerStatuses": [state(name, ready=False) for name in containers(pod)],
    }


def crash_status(pod: Live) -> Live:
    """Return the status of a pod whose containers end with code 1 and are started again."""
    ended = {"terminated": {"exitCode": 1, "reason": "Error"}}
    waits = {"waiting": {"reason": "CrashLoopBackOff"}}
    return {
        "phase": "Running",
        "conditions": [{"type": "Ready", "status": "False"}],
        "containerStatuses": [
            {**state(name, ready=False), "state": waits, "lastState": ended, "restartCount": 2}
            for name in containers(pod)
        ],
    }


def ended(pod: Live, code: int = 0, words: str = "") -> Live:
    """Return the status of a pod whose containers have ended, and are not started again."""
    how = {"exitCode": code, "reason": "Error" if code else "Completed", "message": words}
    return {
        "phase": "Failed" if code else "Succeeded",
        "conditions": [{"type": "Ready", "status": "False"}],
        "containerStatuses": [
            {**state(name, ready=False), "state": {"terminated": how}} for name in containers(pod)
        ],
    }


def containers(pod: Live) -> list[str]:
    return [c["name"] for c in pod["spec"].get("containers") or []]


def state(name: str, *, ready: bool) -> Live:
    return {"name": name, "ready": ready, "state": {"running": {}}, "restartCount": 0}


@attrs.define
class Controllers:
    """Kubernetes' controllers and its kubelets.

    Attributes:
        kubelet: what becomes of a pod that has been started.
        ending: steps that a pod takes to end, by the name of its Deployment; 1 for others.
    """

    kubelet: Callable[[Live], Live] = running
    ending: Mapping[str, int] = attrs.field(factory=dict)
    counted: dict[str, int] = attrs.field(factory=dict)
    idle_at: int = 0

    def step(self, store: Store) -> None:
        """Go one step on; what one controller makes the next one sees in the next step."""
        before = store.version
        if before == self.idle_at:
            return  # nothing has changed since nothing was to be done
        self.look(store)
        ending = any(not lives(pod) for pod in of_kind(store, "Pod"))
        self.idle_at = store.version if store.version == before and not ending else 0

    def look(self, store: Store) -> None:
        """Let each controller look once."""
        self.namespaces(store)
        self.garbage(store)
        for pod in of_kind(store, "Pod"):
            self.pod(store, pod)
        for replica_set in of_kind(store, "ReplicaSet"):
            self.replica_set(store, replica_set)
        for deployment in of_kind(store, "Deployment"):
            self.deployment(store, deployment)
        for one in of_kind(store, "Job"):
            self.job(store, one)
        for live in list(store.objects.values()):
            if made := STATUSES.get(live["kind"]):
                self.status(store, live, made(live))
        for definition in of_kind(store, "CustomResourceDefinition"):
            spec = definition["spec"]
            namespaced = spec.get("scope") == "Namespaced"
            for version in spec["versions"]:
                key = (f"{spec['group']}/{version['name']}", spec["names"]["kind"])
                store.kinds[key] = Resource(spec["names"]["plural"], namespaced)

    def namespaces(self, store: Store) -> None:
        """End namespaces with all that is in them."""
        for space in of_kind(store, "Namespace"):
            if not space["metadata"].get("deletionTimestamp"):
                continue
            inside = [ref for ref in store.objects if ref.namespace == space["metadata"]["name"]]
            for ref in inside:
                store.delete(ref)
            if not inside:
                store.remove(ref_of(space))

    def garbage(self, store: Store) -> None:
        """Delete what has lost its owner."""
        there = {live["metadata"]["uid"] for live in store.objects.values()}
        for ref, live in list(store.objects.items()):
            owners = live["metadata"].get("ownerReferences") or []
            if owners and not any(owner["uid"] in there for owner in owners):
                store.delete(ref)

    def pod(self, store: Store, pod: Live) -> None:
        """Place a pod, start it, end it."""
        meta, spec = pod["metadata"], pod["spec"]
        if meta.get("deletionTimestamp"):
            left = self.counted.setdefault(meta["uid"], self.ending.get(self.whose(pod), 1))
            self.counted[meta["uid"]] = left - 1
            if left <= 1:
                store.remove(ref_of(pod))
        elif spec.get("nodeName"):
            self.status(store, pod, self.kubelet(pod))
        elif spec.get("nodeSelector"):
            text = "0/1 nodes are available: 1 node(s) didn't match Pod's node affinity/selector."
            unplaced = {"type": "PodScheduled", "status": "False", "message": text}
            self.status(store, pod, {"phase": "Pending", "conditions": [unplaced]})
        else:
            placed = {**pod, "spec": {**spec, "nodeName": "node1"}, "status": {"phase": "Pending"}}
            self.put(store, pod, placed)

    def whose(self, pod: Live) -> str:
        return str((pod["metadata"].get("annotations") or {}).get(MADE_FOR, ""))

    def replica_set(self, store: Store, replica_set: Live) -> None:
        """Make or delete pods until there are as many as the set wants."""
        if replica_set["metadata"].get("deletionTimestamp"):
            return
        pods = [p for p in find_owned(store, "Pod", replica_set) if lives(p)]
        wanted = replica_set["spec"]["replicas"]
        for pod in pods[wanted:]:
            store.delete(ref_of(pod))
        meta, template = replica_set["metadata"], replica_set["spec"]["template"]
        for _ in range(wanted - len(pods)):
            store.version += 1
            names = {"name": f"{meta['name']}-{store.version}", "namespace": meta["namespace"]}
            about = clone(template.get("metadata") or {})
            notes = {**(about.get("annotations") or {}), MADE_FOR: meta["annotations"][MADE_FOR]}
            own = {**about, **names, "annotations": notes, "ownerReferences": [owner(replica_set)]}
            pod = {"apiVersion": "v1", "kind": "Pod", "metadata": own}
            store.commit(
                ObjectRef("v1", "Pod", names["namespace"], names["name"]),
                None,
                {**pod, "spec": clone(template.get("spec") or {"containers": []})},
            )

    def job(self, store: Store, job: Live) -> None:
        """Make the pod of a Job, once, and note how it has ended."""
        meta, spec = job["metadata"], job["spec"]
        if not lives(job) or spec.get("suspend") or (job.get("status") or {}).get("conditions"):
            return
        pods = find_owned(store, "Pod", job)
        if not pods:
            about = clone(spec["template"].get("metadata") or {})
            labels = {**(about.get("labels") or {}), **spec["selector"]["matchLabels"]}
            notes = {**(about.get("annotations") or {}), MADE_FOR: meta["name"]}
            store.version += 1
            name = f"{meta['name']}-{store.version}"
            own = {"name": name, "namespace": meta["namespace"], "labels": labels}
            own |= {"annotations": notes, "ownerReferences": [owner(job)]}
            pod = {"apiVersion": "v1", "kind": "Pod", "metadata": own}
            pod["spec"] = clone(spec["template"]["spec"])
            store.commit(ref_of(pod), None, pod)
            return
        phase = (pods[0].get("status") or {}).get("phase")
        status: Live = {"active": 1}
        if phase == "Succeeded":
            status = {"succeeded": 1, "conditions": [{"type": "Complete", "status": "True"}]}
        elif phase == "Failed":
            text = "Job has reached the specified backoff limit"
            failed = {"type": "Failed", "status": "True", "message": text}
            failed["reason"] = "BackoffLimitExceeded"
            status = {"failed": 1, "conditions": [failed]}
        self.status(store, store.objects[ref_of(job)], status)

    def deployment(self, store: Store, live: Live) -> None:
        """Roll a Deployment out: all at once, or after the end of the pods before."""
        if not lives(live):
            return
        sets = find_owned(store, "ReplicaSet", live)
        new = self.newest(store, live, sets)
        old = [one for one in sets if one is not new]
        wanted, ready = live["spec"]["replicas"], ready_pods(store, new)
        left = [pod for one in old for pod in find_owned(store, "Pod", one)]
        recreate = live["spec"]["strategy"]["type"] == "Recreate"
        for one in old:
            if recreate or len(ready) >= wanted:
                self.scale(store, one, 0)
        if not (recreate and left):
            self.scale(store, new, wanted)
        pods = [pod for one in sets for pod in find_owned(store, "Pod", one) if lives(pod)]
        mine = [pod for pod in find_owned(store, "Pod", new) if lives(pod)]
        available = [pod for one in sets for pod in ready_pods(store, one)]
        self.status(
            store,
            store.objects[ref_of(live)],
            {
                "observedGeneration": live["metadata"]["generation"],
                "replicas": len(pods),
                "updatedReplicas": len(mine),
                "availableReplicas": len(available),
            },
        )

    def newest(self, store: Store, live: Live, sets: list[Live]) -> Live:
        """Return the ReplicaSet of a Deployment's template; made where it is missing."""
        text = json.dumps(live["spec"]["template"], sort_keys=True)
        name = f"{live['metadata']['name']}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
        last = max((int(one["metadata"]["annotations"][REVISION]) for one in sets), default=0)
        found = next((one for one in sets if one["metadata"]["name"] == name), None)
        if found is None:
            meta = {
                "name": name,
                "namespace": live["metadata"]["namespace"],
                "labels": clone(live["spec"]["template"]["metadata"].get("labels") or {}),
                "annotations": {REVISION: str(last + 1), MADE_FOR: live["metadata"]["name"]},
                "ownerReferences": [owner(live)],
            }
            spec = {"replicas": 0, "template": clone(live["spec"]["template"])}
            made = {"apiVersion": "apps/v1", "kind": "ReplicaSet", "metadata": meta, "spec": spec}
            found = store.commit(ref_of(made), None, made)
            sets.append(found)
        elif int(found["metadata"]["annotations"][REVISION]) < last:
            self.annotate(store, found, str(last + 1))
            last += 1
            found = store.objects[ref_of(found)]
        self.annotate(store, live, found["metadata"]["annotations"][REVISION])
        return found

    def annotate(self, store: Store, live: Live, revision: str) -> None:
        meta = live["metadata"]
        notes = {**(meta.get("annotations") or {}), REVISION: revision}
        self.put(store, live, {**live, "metadata": {**meta, "annotations": notes}})

    def scale(self, store: Store, replica_set: Live, replicas: int) -> None:
        spec = {**replica_set["spec"], "replicas": replicas}
        self.put(store, replica_set, {**replica_set, "spec": spec})

    def status(self, store: Store, live: Live, status: Live) -> None:
        self.put(store, live, {**live, "status": status})

    def put(self, store: Store, live: Live, new: Live) -> None:
        old = store.objects.get(ref_of(live))
        if old is not None and old != new:
            store.commit(ref_of(live), old, clone(new))


def of_kind(store: Store, kind: str) -> Iterator[Live]:
    """Yield the objects of a kind as they are at the moment, also if they change meanwhile."""
    for ref in [ref for ref in store.objects if ref.kind == kind]:
        if ref in store.objects:
            yield store.objects[ref]


def find_owned(store: Store, kind: str, by: Live) -> list[Live]:
    uid = by["metadata"]["uid"]
    return [
        live
        for live in of_kind(store, kind)
        if any(o["uid"] == uid for o in live["metadata"].get("ownerReferences") or [])
    ]


def lives(live: Live) -> bool:
    return not live["metadata"].get("deletionTimestamp")


def ready_pods(store: Store, replica_set: Live) -> list[Live]:
    return [pod for pod in find_owned(store, "Pod", replica_set) if lives(pod) and is_ready(pod)]


def is_ready(pod: Live) -> bool:
    conditions = (pod.get("status") or {}).get("conditions") or []
    return any(c["type"] == "Ready" and c["status"] == "True" for c in conditions)


def owner(live: Live) -> Live:
    meta = live["metadata"]
    names = {"apiVersion": live["apiVersion"], "kind": live["kind"], "name": meta["name"]}
    return {**names, "uid": meta["uid"], "controller": True}


def daemon_set(live: Live) -> Live:
    counts = ("desiredNumberScheduled", "updatedNumberScheduled", "numberAvailable")
    return {"observedGeneration": live["metadata"]["generation"], **dict.fromkeys(counts, 1)}


def stateful_set(live: Live) -> Live:
    wanted = live["spec"].get("replicas", 1)
    counts = ("replicas", "updatedReplicas", "readyReplicas", "availableReplicas")
    return {"observedGeneration": live["metadata"]["generation"], **dict.fromkeys(counts, wanted)}


#: Kinds that are well at once, without pods.
STATUSES: Mapping[str, Callable[[Live], Live]] = {
    "DaemonSet": daemon_set,
    "StatefulSet": stateful_set,
    "PersistentVolumeClaim": lambda live: {"phase": "Bound"},
    "PersistentVolume": lambda live: {"phase": "Available"},
    "CustomResourceDefinition": lambda live: {
        "conditions": [{"type": "Established", "status": "True"}]
    },
}

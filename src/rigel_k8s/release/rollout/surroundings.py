"""What belongs to the workloads of a release: ReplicaSets, pods, warnings; pure.

All of it is indexed once for each look: a thousand workloads must not search all pods each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

import attrs

from rigel_k8s.objects.refs import Manifest


@attrs.frozen
class Surroundings:
    """What belongs to workloads, by the UID of its owner.

    Attributes:
        sets: ReplicaSets by their owner.
        pods: by their owner, and those without one under their own UID.
        events: warnings by their object, those about claims by the claim's name.
    """

    sets: Mapping[str, Sequence[Manifest]] = attrs.field(factory=dict)
    pods: Mapping[str, Sequence[Manifest]] = attrs.field(factory=dict)
    events: Mapping[str, Sequence[Manifest]] = attrs.field(factory=dict)

    def list_sets(self, workload: Manifest) -> Sequence[Manifest]:
        """Return a workload's ReplicaSets."""
        return self.sets.get(workload["metadata"]["uid"], ())

    def list_pods(self, workload: Manifest) -> list[Manifest]:
        """Return a workload's pods, old ones too."""
        owners = [workload, *self.list_sets(workload)]
        return [pod for one in owners for pod in self.pods.get(one["metadata"]["uid"], ())]

    def list_newest_pods(self, workload: Manifest) -> list[Manifest]:
        """Return the pods of a workload's newest template."""
        return pods_of(workload, self.list_sets(workload), self.list_pods(workload))

    def list_events(self, *objects: Manifest) -> list[Manifest]:
        """Return the warnings about some objects, and about the claims of pods among them."""
        about = [key for live in objects for key in (live["metadata"]["uid"], *list_claims(live))]
        return [event for key in about for event in self.events.get(key, ())]


def look_around(
    sets: Iterable[Manifest], pods: Iterable[Manifest], events: Iterable[Manifest] = ()
) -> Surroundings:
    """Return what a namespace has apart from workloads, indexed."""
    by_set, by_pod, by_object = defaultdict(list), defaultdict(list), defaultdict(list)
    for live in sets:
        by_set[owner(live)].append(live)
    for live in pods:
        by_pod[owner(live) or live["metadata"]["uid"]].append(live)
    for event in events:
        about = event["involvedObject"]
        is_claim = about.get("kind") == "PersistentVolumeClaim"
        by_object[about.get("name" if is_claim else "uid", "")].append(event)
    return Surroundings(by_set, by_pod, by_object)


def list_claims(live: Manifest) -> Iterator[str]:
    """Yield the names of the claims that a pod uses."""
    for volume in (live.get("spec") or {}).get("volumes") or ():
        if "persistentVolumeClaim" in volume:
            yield volume["persistentVolumeClaim"]["claimName"]


def pods_of(
    workload: Manifest, replica_sets: Iterable[Manifest], pods: Iterable[Manifest]
) -> list[Manifest]:
    """Return the pods of a workload's newest template, as far as its kind shows them."""
    uid = workload["metadata"]["uid"]
    if workload["kind"] == "Pod":
        return [pod for pod in pods if pod["metadata"]["uid"] == uid]
    owners = {uid}
    if workload["kind"] == "Deployment":
        owners = {rs["metadata"]["uid"] for rs in find_newest(workload, replica_sets)}
    found = [pod for pod in pods if owner(pod) in owners]
    label, newest = newest_template(workload)
    if not newest:
        return found
    return [pod for pod in found if (pod["metadata"].get("labels") or {}).get(label) == newest]


def newest_template(workload: Manifest) -> tuple[str, str]:
    """Return a label of a workload's pods and its newest value, "" if its kind has none."""
    if workload["kind"] == "StatefulSet":
        revision = (workload.get("status") or {}).get("updateRevision")
        return "controller-revision-hash", str(revision or "")
    if workload["kind"] == "DaemonSet":
        notes = workload["metadata"].get("annotations") or {}
        generation = notes.get("deprecated.daemonset.template.generation")
        return "pod-template-generation", str(generation or "")
    return "", ""


def find_newest(deployment: Manifest, replica_sets: Iterable[Manifest]) -> Iterator[Manifest]:
    """Yield the ReplicaSet of a Deployment's newest template.

    Of a Recreate one it is made when the old pods have ended: until then the number is the old one.
    """
    note = "deployment.kubernetes.io/revision"
    number = (deployment["metadata"].get("annotations") or {}).get(note)
    template = template_of(deployment)
    for replica_set in replica_sets:
        notes = replica_set["metadata"].get("annotations") or {}
        same = notes.get(note) == number and template_of(replica_set) == template
        if same and owner(replica_set) == deployment["metadata"]["uid"]:
            yield replica_set


def template_of(live: Manifest) -> Manifest:
    """Return a workload's template for pods, without the label that Kubernetes adds to it."""
    template = (live.get("spec") or {}).get("template") or {}
    meta = template.get("metadata") or {}
    labels = {**(meta.get("labels") or {})}
    labels.pop("pod-template-hash", None)
    return {**template, "metadata": {**meta, "labels": labels}}


def owner(live: Manifest) -> str:
    """Return the UID of the controller that owns an object, "" for none."""
    for reference in live["metadata"].get("ownerReferences") or []:
        if reference.get("controller"):
            return str(reference["uid"])
    return ""

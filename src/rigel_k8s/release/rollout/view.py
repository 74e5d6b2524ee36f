"""What a release looks like right now, kept up to date by watches instead of repeated lists."""

from __future__ import annotations

import queue
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.watching import WatchEvent
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of

Kind = tuple[str, str]
Live = dict[str, Any]
POD: Kind = ("v1", "Pod")
REPLICA_SET: Kind = ("apps/v1", "ReplicaSet")
EVENT: Kind = ("v1", "Event")
#: What a watch brings: an event, the end of its list (None), or why it has ended.
News = WatchEvent | ClusterError | None
HELPFUL = frozenset({REPLICA_SET, EVENT})  # without the right to see these, less can be explained


class ReleaseView:
    """Objects of a namespace ("" is all) as they change; a context that ends its watches.

    Attributes:
        helpful: the kinds that the view does without where the right to see them is missing.
        listed: the kinds of which all that is there has been seen.
        refused: those of the helpful ones that cannot be watched.
    """

    def __init__(
        self,
        cluster: Cluster,
        namespace: str,
        seconds: float,
        helpful: frozenset[Kind] = HELPFUL,
    ):
        self.cluster, self.namespace, self.seconds = cluster, namespace, seconds
        self.helpful = helpful
        self.listed: set[Kind] = set()
        self.refused: set[Kind] = set()
        self.news: queue.SimpleQueue[tuple[Kind, News]] = queue.SimpleQueue()
        self.objects: dict[Kind, dict[ObjectRef, Live]] = defaultdict(dict)
        self.over = threading.Event()
        self.watched: set[tuple[Kind, str]] = set()

    def __enter__(self) -> ReleaseView:
        return self

    def __exit__(self, *_: object) -> None:
        self.over.set()

    def watch(self, kinds: Iterable[Kind], labels: str = "", fields: str = "") -> None:
        """Start to watch some kinds; those with the same `fields` already are left alone."""
        for kind in kinds:
            if (kind, fields) not in self.watched:
                self.watched.add((kind, fields))
                work = (kind, labels, fields)
                threading.Thread(target=self.follow, args=work, daemon=True).start()

    def follow(self, kind: Kind, labels: str, fields: str) -> None:
        """Put the events of one kind into the queue until the view ends."""
        try:
            for event in self.cluster.watch(
                *kind,
                self.namespace,
                labels=labels,
                fields=fields,
                seconds=self.seconds,
                cancel=self.over,
                listed=lambda: self.news.put((kind, None)),
            ):
                self.news.put((kind, event))
        except ClusterError as error:
            self.news.put((kind, error))

    def refresh(self, timeout: float) -> bool:
        """Process all events, waiting for the first; return whether there was any.

        Raises:
            ClusterError: a watch was refused.
        """
        try:
            kind, news = self.news.get(timeout=timeout)
        except queue.Empty:
            return False
        while True:
            self.take(kind, news)
            try:
                kind, news = self.news.get_nowait()
            except queue.Empty:
                return True

    def take(self, kind: Kind, news: News) -> None:
        """Process one event."""
        if isinstance(news, ClusterError):
            if kind not in self.helpful:
                raise news
            self.refused.add(kind)
            return
        if news is None:
            self.listed.add(kind)
            return
        ref = ref_of(news.object)
        if news.type == "DELETED":
            self.objects[kind].pop(ref, None)
        else:
            self.objects[kind][ref] = news.object

    @property
    def complete(self) -> bool:
        """Whether all that is there has been seen, as far as it may be seen."""
        return {kind for kind, _ in self.watched} <= self.listed | self.refused

    def find(self, ref: ObjectRef) -> Live | None:
        """Return an object, None if it has not been seen yet."""
        return self.objects[ref.api_version, ref.kind].get(ref)

    def find_related(self) -> Related:
        """Return what belongs to workloads now, indexed."""
        return find_related(*(self.objects[kind].values() for kind in (REPLICA_SET, POD, EVENT)))


@attrs.frozen
class Related:
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


def find_related(
    sets: Iterable[Manifest], pods: Iterable[Manifest], events: Iterable[Manifest] = ()
) -> Related:
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
    return Related(by_set, by_pod, by_object)


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

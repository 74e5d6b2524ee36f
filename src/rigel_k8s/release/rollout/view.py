"""What a release looks like right now, kept up to date by watches instead of repeated lists."""

from __future__ import annotations

import queue
import threading
from collections import defaultdict
from collections.abc import Iterable
from typing import Any

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.watching import WatchEvent
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.rollout.surroundings import Surroundings, look_around

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
        self.watched: set[Kind] = set()

    def __enter__(self) -> ReleaseView:
        return self

    def __exit__(self, *_: object) -> None:
        self.over.set()

    def watch(self, kinds: Iterable[Kind], labels: str = "", fields: str = "") -> None:
        """Start to watch some kinds; those that are watched already are left alone."""
        for kind in kinds:
            if kind not in self.watched:
                self.watched.add(kind)
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
        return self.watched <= self.listed | self.refused

    def find(self, ref: ObjectRef) -> Live | None:
        """Return an object, None if it has not been seen yet."""
        return self.objects[ref.api_version, ref.kind].get(ref)

    def look_around(self) -> Surroundings:
        """Return what belongs to workloads now, indexed."""
        return look_around(*(self.objects[kind].values() for kind in (REPLICA_SET, POD, EVENT)))

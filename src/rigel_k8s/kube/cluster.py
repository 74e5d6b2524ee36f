"""One cluster as other packages see it: its objects, its pods, and the cluster itself."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, overload
from urllib.parse import quote

import attrs

from rigel_k8s.kube.answers import read_version
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.ending import LogEnd
from rigel_k8s.kube.execution import Execution
from rigel_k8s.kube.forwarding import Forwarding
from rigel_k8s.kube.resources import with_query
from rigel_k8s.kube.store import Store
from rigel_k8s.kube.target import Target
from rigel_k8s.kube.transport import Endurance
from rigel_k8s.kube.watching import Watching
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.system import threads
from rigel_k8s.system.threads import aborting


class Pods:
    """The containers of a cluster's pods."""

    client: Client

    def logs(
        self,
        namespace: str,
        pod: str,
        container: str | None = None,
        *,
        follow: bool = False,
        since_seconds: int | None = None,
        since_time: str | None = None,
        tail: int | None = None,
        previous: bool = False,
        timestamps: bool = False,
        cancel: threading.Event | None = None,
    ) -> Iterator[str]:
        """Yield a container's log lines without their ends.

        Args:
            container: None is the pod's only one.
            since_time: as Kubernetes writes times, in whole seconds; instead of `since_seconds`.
            previous: the container's life before its last restart.
            cancel: ends a follow soon after it is set.
        """
        what = f"read the logs of Pod {namespace}/{pod}"
        query = {
            "container": container,
            "follow": follow and "true",
            "sinceSeconds": since_seconds,
            "sinceTime": since_time,
            "tailLines": None if tail is None else str(tail),
            "previous": previous and "true",
            "timestamps": timestamps and "true",
        }
        ref = ObjectRef("v1", "Pod", namespace, pod)
        stream = self.client.stream(
            self.client.path_of(ref, what, subresource="log", query=query), what
        )
        with aborting(stream, cancel):
            for line in stream.lines():
                yield line.decode("utf-8", "replace")

    def follow_end(self, namespace: str, pod: str, container: str, *, seconds: float) -> LogEnd:
        """Begin to follow a container's log, which ends when the container does.

        Args:
            seconds: how long it must go on, at least, before the container counts as running.
        """
        return LogEnd(self.client, ObjectRef("v1", "Pod", namespace, pod), container, seconds)


T = TypeVar("T")
R = TypeVar("R")


class Cluster(Store, Watching, Pods, Execution, Forwarding):
    """A cluster and our user there; safe to use from several threads."""

    def __init__(self, target: Target):
        self.client = Client(target)
        self.namespace = target.namespace
        self.server = target.server
        self.context_name = target.context

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all open connections."""
        self.client.transport.connections.close()

    def endure(self, log: Callable[[str], None], cancel: threading.Event) -> None:
        """Wait from now on if a known API server becomes unreachable, up to two minutes.

        Args:
            log: called with a line when a wait begins, and when it is over.
            cancel: ends such a wait.
        """
        self.client.transport.endurance = Endurance(log, cancel)

    def sum_outages(self) -> float:
        """Return for how many seconds the API server was unreachable since `endure`."""
        endurance = self.client.transport.endurance
        return 0.0 if endurance is None else endurance.sum_outages()

    @contextmanager
    def guard_writes(self, guard: Callable[[], None]) -> Iterator[None]:
        """Call a function before any write is sent again, while the context is open.

        Much may have happened between the two: an error of the function ends the write.
        """
        transport = self.client.transport
        before, transport.guard = transport.guard, guard
        try:
            yield
        finally:
            transport.guard = before

    def server_version(self) -> str:
        """Return the API server's version: v1.34.4."""
        return self.client.call("GET", "/version", "read the version", read_version)

    def serves(self, api_version: str, kind: str) -> bool:
        """Whether the cluster has a kind (now; it may be defined later)."""
        return self.client.resources.find(api_version, kind) is not None

    def nodes(self) -> Sequence[dict[str, Any]]:
        return self.list("v1", "Node")

    def events(self, live: Manifest) -> Sequence[dict[str, Any]]:
        """Return the events of one live object, the oldest first."""
        meta = live["metadata"]
        fields = f"involvedObject.uid={meta['uid']}"
        found = self.list("v1", "Event", meta.get("namespace"), fields=fields)
        return sorted(found, key=event_time)

    def parallel(
        self, function: Callable[[T], R], items: Iterable[T], *, width: int = threads.WIDTH
    ) -> Sequence[R]:
        """Call a function for all items on a few threads; results in the order of the items."""
        return threads.parallel(function, items, width=width)

    @overload
    def gather(self, first: Callable[[], T], second: Callable[[], R], /) -> tuple[T, R]: ...

    @overload
    def gather(self, *calls: Callable[[], Any]) -> tuple[Any, ...]: ...

    def gather(self, *calls: Callable[[], Any]) -> tuple[Any, ...]:
        """Make calls side by side on a few threads, and return their results in order."""
        return tuple(self.parallel(lambda call: call(), calls))

    def get_through_proxy(
        self,
        ref: ObjectRef,
        inner: str,
        *,
        port: int | None = None,
        query: Mapping[str, object] | None = None,
    ) -> bytes:
        """Return the answer of a Service or a Node to a GET that the API server passes on.

        Args:
            inner: the path there: `loki/api/v1/series`.
            port: the Service's; a Node answers on its kubelet's.
            query: a list is a parameter that occurs several times.

        Raises:
            Refusal: 403 if the right is missing, 503 if nothing is ready behind it, and its own
                errors.
        """
        what = f"query {ref}"
        address = ref if port is None else attrs.evolve(ref, name=f"{ref.name}:{port}")
        url = f"{self.client.path_of(address, what, subresource='proxy')}/{quote(inner)}"
        # 503 means that nothing is ready behind it.
        answer = self.client.transport.request("GET", with_query(url, query), what, endures=False)
        self.client.raise_for(answer, what)
        return answer.body


def event_time(event: Mapping[str, Any]) -> str:
    """Return when an event was last seen, in a form that sorts."""
    series = event.get("series") or {}
    seen = series.get("lastObservedTime") or event.get("lastTimestamp") or event.get("eventTime")
    return str(seen or event["metadata"].get("creationTimestamp") or "")

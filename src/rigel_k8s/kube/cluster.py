"""One cluster as the other rooms see it: objects in, objects out, no HTTP words."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, TypeVar
from urllib.parse import quote

import attrs

from rigel_k8s.kube import threads
from rigel_k8s.kube.answers import find_mapping, read_list, read_mapping, read_object, read_version
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.conditions import ANYTHING, Onto, another_object_error
from rigel_k8s.kube.failures import Conflict, Missing, Refusal
from rigel_k8s.kube.resending import Endurance
from rigel_k8s.kube.resources import path, with_query
from rigel_k8s.kube.target import Target
from rigel_k8s.kube.watching import WatchEvent, label_selector, watch
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of

if TYPE_CHECKING:
    from rigel_k8s.kube.execution import ExecResult
    from rigel_k8s.kube.forwarding import Forward

MANAGER = "rigel"  # who owns the fields that we apply
PAGE = 500
DELETES = 3  # times that an object is deleted where something writes to it at the same moment
METADATA_ONLY = "application/json;as=PartialObjectMetadataList;g=meta.k8s.io;v=v1"
PATCHES = {
    "merge": "application/merge-patch+json",
    "json": "application/json-patch+json",
    "strategic": "application/strategic-merge-patch+json",
    "apply": "application/apply-patch+yaml",  # JSON is YAML
}
T = TypeVar("T")
R = TypeVar("R")


class Cluster:
    """A cluster and who we are there; safe to use from several threads."""

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
        """Close all connections that are kept open."""
        self.client.transport.close()

    def endure(self, tell: Callable[[str], None], cancel: threading.Event) -> None:
        """Wait from now on for an API server that has answered and goes away, up to two minutes.

        Args:
            tell: takes a line that says what is waited for, and one when it is over.
            cancel: ends such a wait.
        """
        self.client.transport.endurance = Endurance(tell, cancel)

    def sum_outages(self) -> float:
        """Return for how many seconds the API server was away since `endure`."""
        endurance = self.client.transport.endurance
        return 0.0 if endurance is None else endurance.sum_outages()

    @contextmanager
    def guard_writes(self, guard: Callable[[], None]) -> Iterator[None]:
        """Call a function before any write is sent again, while the context is open.

        Between the two, much may have happened: what the function raises ends the write.
        """
        transport = self.client.transport
        before, transport.guard = transport.guard, guard
        try:
            yield
        finally:
            transport.guard = before

    # Objects.

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        """Return an object, None where it or its kind is not there."""
        try:
            what = f"read {ref}"
            return self.client.call("GET", self.path_of(ref, what), what, read_object)
        except Missing:
            return None

    def list(
        self,
        api_version: str,
        kind: str,
        namespace: str | None = None,
        *,
        labels: str | Mapping[str, str] | None = None,
        fields: str | None = None,
        metadata_only: bool = False,
    ) -> list[dict[str, Any]]:
        """Return all objects of a kind, of one namespace or of all; none where the kind is unknown.

        Args:
            labels: a label selector, or labels that must all be there.
            fields: a field selector.
            metadata_only: leave spec, data and status out, which saves time.
        """
        resource = self.client.resources.find(api_version, kind)
        if resource is None:
            return []
        query: dict[str, Any] = {
            "labelSelector": label_selector(labels),
            "fieldSelector": fields,
            "limit": PAGE,
        }
        accept = METADATA_ONLY if metadata_only else "application/json"
        found: list[dict[str, Any]] = []
        while True:
            url = path(api_version, resource, namespace or "", query=query)
            page = self.client.call("GET", url, f"list {kind}s", read_list, accept=accept)
            found += page.get("items") or []
            query["continue"] = page["metadata"].get("continue")
            if not query["continue"]:
                return [{**item, "apiVersion": api_version, "kind": kind} for item in found]

    def apply(
        self,
        manifest: Manifest,
        *,
        force: bool = False,
        dry_run: bool = False,
        onto: Onto = ANYTHING,
    ) -> dict[str, Any]:
        """Apply a manifest server-side and return what the object is then.

        What we patched before, without an apply, is ours: Kubernetes keeps that as a record of its
        own, beside which an apply with another value would be a conflict with ourselves.

        Args:
            force: take fields over that another manager owns.
            onto: what must be there for the apply to have an effect.

        Raises:
            Conflict: another manager owns fields with other values (`fields` names them), or
                something else is there than `onto` says (`fields` is empty).
        """
        ref = ref_of(manifest)
        what = f"apply {ref}"
        query = {"fieldManager": MANAGER, "force": force and "true", "dryRun": dry_run and "All"}
        url = self.path_of(ref, what, query=query)
        body = {**manifest, "metadata": {**manifest["metadata"], **onto.metadata}}
        try:
            return self.client.write("PATCH", url, what, body, PATCHES["apply"])
        except Conflict as error:
            if force or {field.manager for field in error.fields} != {MANAGER}:
                raise
        except Refusal as error:
            if "metadata.uid" not in {cause.field for cause in error.causes}:
                raise
            raise another_object_error(error) from error
        return self.apply(manifest, force=True, dry_run=dry_run, onto=onto)

    def create(self, manifest: Manifest, *, dry_run: bool = False) -> dict[str, Any]:
        """Create an object; Conflict (reason AlreadyExists) where it is there."""
        ref = ref_of(manifest)
        what = f"create {ref}"
        resource = self.client.resource(ref.api_version, ref.kind, what)
        query = {"fieldManager": MANAGER, "dryRun": dry_run and "All"}
        url = path(ref.api_version, resource, ref.namespace, query=query)
        return self.client.write("POST", url, what, manifest)

    def review(self, api_version: str, kind: str, spec: Mapping[str, Any]) -> Mapping[str, Any]:
        """Ask by a review, an object that is answered and not kept; return its status."""
        what = f"ask the API server by {kind}"
        url = path(api_version, self.client.resource(api_version, kind, what), "")
        # It stores nothing anyway; a dry run shows that to who reads the requests of a deploy.
        url = with_query(url, {"dryRun": "All"})
        body = {"apiVersion": api_version, "kind": kind, "spec": spec}
        answer = self.client.call("POST", url, what, read_mapping, body=body, safe=True)
        return find_mapping(answer, "status")

    def replace(self, manifest: Manifest, *, dry_run: bool = False) -> dict[str, Any]:
        """Replace an object; Conflict where its resourceVersion is said and no longer true."""
        ref = ref_of(manifest)
        what = f"replace {ref}"
        query = {"fieldManager": MANAGER, "dryRun": dry_run and "All"}
        return self.client.write("PUT", self.path_of(ref, what, query=query), what, manifest)

    def patch(
        self,
        ref: ObjectRef,
        body: object,
        *,
        style: Literal["merge", "json", "strategic"] = "merge",
        subresource: str = "",
        dry_run: bool = False,
    ) -> dict[str, Any]:
        """Patch an object."""
        what = f"patch {ref}"
        query = {"fieldManager": MANAGER, "dryRun": dry_run and "All"}
        url = self.path_of(ref, what, subresource=subresource, query=query)
        safe = style != "json"  # its steps may depend on what was there
        return self.client.write("PATCH", url, what, body, PATCHES[style], safe=safe)

    def delete(
        self,
        ref: ObjectRef,
        *,
        uid: str | None = None,
        version: str | None = None,
        propagation: Literal["Background", "Foreground", "Orphan"] = "Background",
        grace_seconds: int | None = None,
        dry_run: bool = False,
    ) -> bool:
        """Delete an object and return whether it was there.

        Args:
            uid: delete this very object; Conflict where another has its name now. After a conflict
                about anything else it is tried again.
            version: delete it in this very state; Conflict where it has changed since.
        """
        options: dict[str, Any] = {
            "kind": "DeleteOptions",
            "apiVersion": "v1",
            "propagationPolicy": propagation,
        }
        conditions = {"uid": uid, "resourceVersion": version}
        if set_conditions := {key: value for key, value in conditions.items() if value}:
            options["preconditions"] = set_conditions
        if grace_seconds is not None:
            options["gracePeriodSeconds"] = grace_seconds
        if dry_run:
            options["dryRun"] = ["All"]
        for _ in range(DELETES):
            try:
                return self._delete(ref, options)
            except Conflict as error:
                if version or not uid:
                    raise
                conflict, live = error, self.get(ref)
                if live is None:
                    return True
                if live["metadata"]["uid"] != uid:
                    raise
        raise Refusal(
            conflict.message, hint="it is still there: run the command again"
        ) from conflict

    def _delete(self, ref: ObjectRef, options: Mapping[str, Any]) -> bool:
        what = f"delete {ref}"
        try:
            url = self.path_of(ref, what)
            self.client.call("DELETE", url, what, read_mapping, body=options, safe=True)
        except Missing as error:
            return error.doubtful
        return True

    def watch(
        self,
        api_version: str,
        kind: str,
        namespace: str | None = None,
        *,
        labels: str | Mapping[str, str] | None = None,
        fields: str | None = None,
        seconds: float = 300.0,
        cancel: threading.Event | None = None,
    ) -> Iterator[WatchEvent]:
        """Yield what is there (as ADDED) and then what changes.

        Args:
            seconds: after which the watch ends.
            cancel: ends the watch soon after it is set.
        """
        selectors = {"labelSelector": label_selector(labels), "fieldSelector": fields}
        return watch(
            self.client,
            api_version,
            kind,
            namespace or "",
            selectors,
            seconds=seconds,
            cancel=cancel,
        )

    # The cluster.

    def server_version(self) -> str:
        """Return the API server's version: v1.34.4."""
        return self.client.call("GET", "/version", "ask for the version", read_version)

    def serves(self, api_version: str, kind: str) -> bool:
        """Whether the cluster has a kind (now; it may be defined later)."""
        return self.client.resources.find(api_version, kind) is not None

    def nodes(self) -> Sequence[dict[str, Any]]:
        """Return all nodes."""
        return self.list("v1", "Node")

    def events(self, live: Manifest) -> Sequence[dict[str, Any]]:
        """Return what the cluster told about one live object, the oldest first."""
        meta = live["metadata"]
        fields = f"involvedObject.uid={meta['uid']}"
        found = self.list("v1", "Event", meta.get("namespace"), fields=fields)
        return sorted(found, key=event_time)

    def parallel(
        self, function: Callable[[T], R], items: Iterable[T], *, width: int = threads.WIDTH
    ) -> Sequence[R]:
        """Call a function for all items on a few threads; results in the order of the items."""
        return threads.parallel(function, items, width=width)

    def get_through_proxy(
        self,
        ref: ObjectRef,
        inner: str,
        *,
        port: int | None = None,
        query: Mapping[str, object] | None = None,
    ) -> bytes:
        """Return what a Service or a Node answers to a GET that the API server passes on.

        Args:
            inner: the path there: `loki/api/v1/series`.
            port: the Service's; a Node answers on its kubelet's.
            query: a list is a parameter that is said several times.

        Raises:
            Refusal: 403 where the right is missing, 503 where nothing is ready behind it, and what
                it answers itself.
        """
        what = f"ask {ref}"
        address = ref if port is None else attrs.evolve(ref, name=f"{ref.name}:{port}")
        url = f"{self.path_of(address, what, subresource='proxy')}/{quote(inner)}"
        # 503 says that nothing is ready behind it.
        answer = self.client.transport.request("GET", with_query(url, query), what, endures=False)
        self.client.raise_for(answer, what)
        return answer.body

    # Pods.

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
        stream = self.client.stream(self.path_of(ref, what, subresource="log", query=query), what)
        with threads.aborting(stream, cancel):
            for line in stream.lines():
                yield line.decode("utf-8", "replace")

    def runs(self, namespace: str, pod: str, container: str, *, seconds: float) -> bool:
        """Whether a container's log goes on for some seconds; True where nobody can tell.

        A log ends with its container, while the pod's status says for a second and more that it
        runs: this is what its container runtime says now.

        Args:
            seconds: at least; where an answer takes long, four times as long as one.
        """
        from rigel_k8s.kube.following import goes_on

        return goes_on(self.client, namespace, pod, container, seconds=seconds)

    def run(
        self,
        namespace: str,
        pod: str,
        command: Sequence[str],
        *,
        container: str | None = None,
        stdin: bytes | None = None,
        timeout: float = 60.0,
    ) -> ExecResult:
        """Run a command in a container and return its output and exit code.

        Raises:
            ClusterError: it did not end within `timeout` seconds.
        """
        from rigel_k8s.kube.execution import run

        return run(
            self.client, namespace, pod, command, container=container, stdin=stdin, timeout=timeout
        )

    def exec(
        self,
        namespace: str,
        pod: str,
        command: Sequence[str],
        *,
        stdout: BinaryIO,
        stderr: BinaryIO,
        stdin: BinaryIO | None = None,
        container: str | None = None,
        tty: bool = False,
    ) -> int:
        """Run a command in a container on the given streams and return its exit code.

        Args:
            tty: give it a terminal; `stdin` must be one too, and is in raw mode meanwhile.
        """
        from rigel_k8s.kube.execution import exec_on

        return exec_on(
            self.client,
            namespace,
            pod,
            command,
            container=container,
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            tty=tty,
        )

    def port_forward(
        self, namespace: str, pod: str, ports: Mapping[int, int], *, address: str = "127.0.0.1"
    ) -> AbstractContextManager[Forward]:
        """Serve ports of a pod on this machine while the context is open.

        Args:
            ports: the pod's port to the local one; 0 takes any that is free.
        """
        from rigel_k8s.kube.forwarding import port_forward

        return port_forward(self.client, namespace, pod, ports, address=address)

    def path_of(
        self,
        ref: ObjectRef,
        what: str,
        *,
        subresource: str = "",
        query: Mapping[str, object] | None = None,
    ) -> str:
        """Return the URL path of one object."""
        resource = self.client.resource(ref.api_version, ref.kind, what)
        return path(ref.api_version, resource, ref.namespace, ref.name, subresource, query=query)


def event_time(event: Mapping[str, Any]) -> str:
    """Return when an event was last seen, in a form that sorts."""
    series = event.get("series") or {}
    seen = series.get("lastObservedTime") or event.get("lastTimestamp") or event.get("eventTime")
    return str(seen or event["metadata"].get("creationTimestamp") or "")

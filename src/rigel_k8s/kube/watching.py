"""Watches that survive: it handles time limits, lost connections and expired versions."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.kube.answers import parse, read_event, read_start
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.failures import Garbled, Refusal
from rigel_k8s.kube.resources import path
from rigel_k8s.system.threads import aborting

PAUSE = 1.0  # seconds before a lost watch is opened again
LIVES = 5  # connections in a row that may end with an invalid event
SILENCE = 15.0  # seconds beyond the server's own limit after which a stream counts as dead


@attrs.frozen
class WatchEvent:
    """What happened to an object: ADDED, MODIFIED or DELETED."""

    type: str
    object: dict[str, Any]


@attrs.define
class Watched:
    """What a watch has seen: the newest version, "" for none, and the existing objects.

    Attributes:
        garbled: how many connections in a row brought only invalid events.
        forgotten: how many versions in a row the server has forgotten after listing them.
    """

    kind: str
    version: str = ""
    garbled: int = 0
    forgotten: int = 0
    seen: dict[str, dict[str, Any]] = attrs.field(factory=dict)

    def remember(self, event: WatchEvent) -> None:
        meta = event.object["metadata"]
        self.garbled = self.forgotten = 0
        if event.type == "DELETED":
            self.seen.pop(meta["uid"], None)
        elif event.type != "BOOKMARK":
            self.seen[meta["uid"]] = event.object
        self.version = str(meta.get("resourceVersion") or self.version)


def label_selector(labels: str | Mapping[str, str] | None) -> str:
    if labels is None or isinstance(labels, str):
        return labels or ""
    return ",".join(f"{key}={value}" for key, value in labels.items())


class Watching:
    """What changes in a cluster."""

    client: Client

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
        listed: Callable[[], None] | None = None,
    ) -> Iterator[WatchEvent]:
        """Yield what exists as ADDED, then every change.

        If the server has forgotten the version that we saw, everything is listed again: what exists
        is reported as MODIFIED, what was deleted meanwhile as DELETED.

        Args:
            seconds: after which the watch ends.
            cancel: ends the watch soon after it is set.
            listed: called each time that all that is there has been yielded.

        Raises:
            ClusterError: the first connection fails, or the server refuses.
        """
        resource = self.client.resource(api_version, kind, f"watch {kind}s")
        selectors = {"labelSelector": label_selector(labels), "fieldSelector": fields}

        def url(**query: object) -> str:
            return path(api_version, resource, namespace or "", query={**selectors, **query})

        state = Watched(kind)
        deadline = time.monotonic() + seconds
        while not (cancel and cancel.is_set()) and (left := deadline - time.monotonic()) > 0:
            try:
                for event in one_life(self.client, url, state, left, cancel, listed):
                    named = {**event.object, "apiVersion": api_version, "kind": kind}
                    yield attrs.evolve(event, object=named)
            except Refusal as error:
                if not state.version or error.status in (401, 403, 404):
                    raise
                if isinstance(error, Garbled):
                    state.garbled += 1
                    if state.garbled == LIVES:
                        raise
                if error.status == 410:
                    state.version = ""
                    state.forgotten += 1
                    if state.forgotten == 1:
                        continue
            pause(deadline, cancel)


def one_life(
    client: Client,
    url: Callable[..., str],
    state: Watched,
    left: float,
    cancel: threading.Event | None,
    listed: Callable[[], None] | None,
) -> Iterator[WatchEvent]:
    """Yield events until one connection ends; list first if no version is known."""
    if not state.version:
        yield from relist(client, url(), state)
        if listed:
            listed()
    stream = url(
        watch="true",
        timeoutSeconds=max(1, round(left)),
        resourceVersion=state.version,
        allowWatchBookmarks="true",
    )
    for event in events(client, stream, f"watch {state.kind}s", left, cancel):
        state.remember(event)
        if event.type != "BOOKMARK":
            yield event


def events(
    client: Client, url: str, what: str, left: float, cancel: threading.Event | None
) -> Iterator[WatchEvent]:
    """Yield one connection's events; raises Refusal with status 410 for an expired version."""
    stream = client.stream(url, what, timeout=left + SILENCE)
    with aborting(stream, cancel):
        for line in stream.lines():
            try:
                kind, found = read_event(parse(line))
            except ValueError as error:
                raise client.garbled_error(what, url, line, str(error)) from error
            if kind == "ERROR":
                refused = Refusal(f"cannot {what}: {found.get('message')}")
                code = found.get("code")
                refused.status = code if isinstance(code, int) else 0
                raise refused
            yield WatchEvent(kind, found)


def relist(client: Client, url: str, state: Watched) -> list[WatchEvent]:
    """Return the changes since `state`, which becomes the present."""
    page = client.call("GET", url, f"list {state.kind}s", read_start)
    there = {item["metadata"]["uid"]: item for item in page.get("items") or []}
    gone = [WatchEvent("DELETED", old) for uid, old in state.seen.items() if uid not in there]
    now = [
        WatchEvent("MODIFIED" if uid in state.seen else "ADDED", item)
        for uid, item in there.items()
    ]
    state.seen, state.version = there, page["metadata"]["resourceVersion"]
    return gone + now


def pause(deadline: float, cancel: threading.Event | None) -> None:
    """Wait a little before the next connection, no longer than there is time."""
    wait = min(PAUSE, deadline - time.monotonic())
    if wait > 0:
        (cancel or threading.Event()).wait(wait)

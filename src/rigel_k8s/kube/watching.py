"""Watches that survive: time limits, lost connections and expired versions are handled here."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.kube.client import Client
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.kube.resources import path
from rigel_k8s.kube.threads import aborting

__all__ = ["WatchEvent", "label_selector", "watch"]

PAUSE = 1.0  # seconds before a lost watch is opened again
SILENCE = 15.0  # seconds beyond the server's own limit after which a stream counts as dead


@attrs.frozen
class WatchEvent:
    """What happened to an object: ADDED, MODIFIED or DELETED."""

    type: str
    object: dict[str, Any]


def label_selector(labels: str | Mapping[str, str] | None) -> str:
    """Return labels as a selector."""
    if labels is None or isinstance(labels, str):
        return labels or ""
    return ",".join(f"{key}={value}" for key, value in labels.items())


def watch(
    client: Client,
    api_version: str,
    kind: str,
    namespace: str,
    selectors: Mapping[str, object],
    *,
    seconds: float,
    cancel: threading.Event | None,
) -> Iterator[WatchEvent]:
    """Yield what is there as ADDED, then every change, until `seconds` are over.

    Where the server has forgotten the version that we saw, everything is listed again: what is
    there comes as MODIFIED, what has gone meanwhile as DELETED.

    Raises:
        ClusterError: the first connection fails, or the server refuses.
    """
    what = f"watch {kind}s"
    resource = client.resource(api_version, kind, what)
    deadline = time.monotonic() + seconds
    seen: dict[str, dict[str, Any]] = {}
    version = ""
    named = {"apiVersion": api_version, "kind": kind}
    while not (cancel and cancel.is_set()) and (left := deadline - time.monotonic()) > 0:
        try:
            if not version:
                version, found = relist(
                    client, kind, path(api_version, resource, namespace, query=selectors), seen
                )
                for event in found:
                    yield attrs.evolve(event, object={**event.object, **named})
            live = {
                "watch": "true",
                "timeoutSeconds": max(1, round(left)),
                "resourceVersion": version,
                "allowWatchBookmarks": "true",
            }
            url = path(api_version, resource, namespace, query={**selectors, **live})
            for event in events(client, url, what, left, cancel):
                version = remember(event, seen, version)
                if event.type != "BOOKMARK":
                    yield attrs.evolve(event, object={**event.object, **named})
        except Refusal as error:
            if not version or error.status in (401, 403, 404):
                raise
            if error.status == 410:
                version = ""
                continue
        pause(deadline, cancel)


def events(
    client: Client, url: str, what: str, left: float, cancel: threading.Event | None
) -> Iterator[WatchEvent]:
    """Yield one connection's events; raises Refusal with status 410 for an expired version."""
    stream = client.stream(url, what, timeout=left + SILENCE)
    with aborting(stream, cancel):
        for line in stream.lines():
            try:
                event = json.loads(line)
            except ValueError:
                return  # cut off in the middle of a line
            if event["type"] == "ERROR":
                error = Refusal(f"cannot {what}: {event['object'].get('message')}")
                error.status = event["object"].get("code", 0)
                raise error
            yield WatchEvent(event["type"], event["object"])


def remember(event: WatchEvent, seen: dict[str, dict[str, Any]], version: str) -> str:
    """Note what is there after an event; return the version seen last."""
    meta = event.object["metadata"]
    if event.type == "DELETED":
        seen.pop(meta["uid"], None)
    elif event.type != "BOOKMARK":
        seen[meta["uid"]] = event.object
    return str(meta.get("resourceVersion") or version)


def relist(
    client: Client, kind: str, url: str, seen: dict[str, dict[str, Any]]
) -> tuple[str, list[WatchEvent]]:
    """Return the present version and what has happened since `seen`, which becomes the present."""
    page = client.call("GET", url, f"list {kind}s")
    there = {item["metadata"]["uid"]: item for item in page.get("items") or []}
    gone = [WatchEvent("DELETED", old) for uid, old in seen.items() if uid not in there]
    now = [WatchEvent("MODIFIED" if uid in seen else "ADDED", item) for uid, item in there.items()]
    seen.clear()
    seen.update(there)
    return str(page["metadata"]["resourceVersion"]), gone + now


def pause(deadline: float, cancel: threading.Event | None) -> None:
    """Wait a little before the next connection, no longer than there is time."""
    wait = min(PAUSE, deadline - time.monotonic())
    if wait > 0:
        (cancel or threading.Event()).wait(wait)

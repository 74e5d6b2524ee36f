"""A stand-in for all kubelets: pods become ready after a moment, except those of a bad image."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from bench.chaos.control_plane import Server
from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ObjectRef

BAD = "bad"  # an image with this in its name cannot be pulled
DELAY = 0.3  # seconds until a pod is ready


@contextmanager
def kubelet(server: Server) -> Iterator[None]:
    """Take care of all pods while the context is open."""
    over = threading.Event()
    thread = threading.Thread(target=follow, args=(server, over), daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(5)


def follow(server: Server, over: threading.Event) -> None:
    """Give each new pod its status; what fails is tried again by the next watch."""
    with server.connect() as cluster:
        while not over.is_set():
            done: set[str] = set()
            with suppress(ClusterError):
                for event in cluster.watch("v1", "Pod", seconds=60, cancel=over):
                    pod = event.object
                    meta = pod["metadata"]
                    if event.type == "DELETED" or meta["uid"] in done:
                        continue
                    done.add(meta["uid"])
                    time.sleep(0.01)
                    ref = ObjectRef("v1", "Pod", meta["namespace"], meta["name"])
                    timer = threading.Timer(DELAY, set_status, (cluster, ref, status(pod)))
                    timer.daemon = True
                    timer.start()


def set_status(cluster: Any, ref: ObjectRef, value: Mapping[str, Any]) -> None:
    """Write a pod's status; the pod may be deleted already."""
    with suppress(ClusterError):
        cluster.patch(ref, {"status": value}, subresource="status")


def status(pod: Mapping[str, Any]) -> dict[str, Any]:
    """Return the status of a pod that runs, or waits for its image."""
    now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    bad = any(BAD in one["image"] for one in pod["spec"]["containers"])
    waiting = {"waiting": {"reason": "ImagePullBackOff", "message": "no such image"}}
    containers = [
        {
            "name": one["name"],
            "image": one["image"],
            "imageID": "",
            "ready": not bad,
            "restartCount": 0,
            "state": waiting if bad else {"running": {"startedAt": now}},
        }
        for one in pod["spec"]["containers"]
    ]
    word = "False" if bad else "True"
    kinds = ("PodScheduled", "Initialized", "ContainersReady", "Ready")
    return {
        "phase": "Pending" if bad else "Running",
        "conditions": [
            {"type": kind, "status": "True" if n < 2 else word, "lastTransitionTime": now}
            for n, kind in enumerate(kinds)
        ],
        "containerStatuses": containers,
    }

"""What the containers of pods have printed, and whether they run."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import suppress

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.client import Client
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.system.threads import aborting

ANSWERS = 8  # durations of an answer: how long the end of a log may take


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

    def runs(self, namespace: str, pod: str, container: str, *, seconds: float) -> bool:
        """Whether a container's log continues for some seconds; True if that is unknown.

        A log ends when its container ends. The pod's status still reports for a second or more that
        the container runs; the log has the present answer of the container runtime. A quiet
        container's log and a slow machine both send nothing for a while: so the time of an answer
        that certainly comes is measured first.
        """
        what = f"follow the log of Pod {namespace}/{pod}"
        query = {"container": container, "tailLines": "0"}
        ref = ObjectRef("v1", "Pod", namespace, pod)
        url = self.client.path_of(ref, what, subresource="log", query=query)
        with suppress(ClusterError):
            started = time.monotonic()
            self.client.raise_for(self.client.transport.request("GET", url, what), what)
            patience = max(seconds, ANSWERS * (time.monotonic() - started))
            return self.client.transport.goes_on(f"{url}&follow=true", patience)
        return True

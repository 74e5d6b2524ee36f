"""Whether a container runs at this moment: the stream of its log ends when it does."""

from __future__ import annotations

import time
from contextlib import suppress

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.resources import path

ANSWERS = 8  # how long a stream has to end, in durations of an answer


def goes_on(client: Client, namespace: str, pod: str, container: str, *, seconds: float) -> bool:
    """Return whether a log has not ended after some seconds; an unreadable one has not.

    A quiet container's log and a slow machine both send nothing for a while. So the time of an
    answer that certainly comes is measured first.
    """
    what = f"follow the log of Pod {namespace}/{pod}"
    resource = client.resource("v1", "Pod", what)

    def url(**query: str) -> str:
        asked = {"container": container, "tailLines": "0", **query}
        return path("v1", resource, namespace, pod, "log", query=asked)

    with suppress(ClusterError):
        started = time.monotonic()
        client.raise_for(client.transport.request("GET", url(), what), what)
        patience = max(seconds, ANSWERS * (time.monotonic() - started))
        return client.transport.goes_on(url(follow="true"), patience)
    return True

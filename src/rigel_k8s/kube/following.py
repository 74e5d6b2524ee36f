"""Whether a container runs at this moment: the stream of its log ends when it does."""

from __future__ import annotations

import time
from contextlib import suppress

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.resources import path

ANSWERS = 8  # how many times as long as an answer takes a stream has to end


def goes_on(client: Client, namespace: str, pod: str, container: str, *, seconds: float) -> bool:
    """Return whether a log has not ended after some seconds; what cannot be read has not.

    A quiet container's log and a slow machine both say nothing for a while. So an answer that comes
    in any case is timed before.
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

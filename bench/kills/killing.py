"""A process that dies at the n-th write that it sends to an API server.

A fork of a process that has imported everything makes a kill cheap. The parent itself never opens a
connection or starts a thread, since neither survives a fork.
"""

from __future__ import annotations

import os
import pickle
import re
import signal
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import attrs
from urllib3.connection import HTTPConnection

from rigel_k8s.kube import connect
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.settings import Settings
from rigel_k8s.system.threads import parallel

Moment = Literal["before", "sent", "after"]
MOMENTS: tuple[Moment, ...] = ("before", "sent", "after")
#: A Lease is renewed every few seconds; a renewal is not a step of a command.
RENEWAL = "patch Lease"


def describe(what: str, namespace: str) -> str:
    """Return a step's name: verb, kind and name, without the namespace."""
    return re.sub(rf"\b{namespace}/", "", what)


@attrs.define
class Fuse:
    """Counts the writes of a cluster's client and kills the process at one of them.

    Attributes:
        limit: the write at which it dies; 0: never.
        steps: the writes so far.
        say: called with the step's name right before the end.
    """

    limit: int
    moment: Moment
    say: Callable[[str], None]
    steps: list[str] = attrs.field(factory=list)
    lock: threading.Lock = attrs.field(factory=threading.Lock)
    lit: bool = False

    def attach(self, cluster: Cluster) -> None:
        """Intercept each request of a client."""
        transport, send = cluster.client.transport, cluster.client.transport.request
        receive = HTTPConnection.getresponse

        def request(method: str, path: str, what: str, **options: Any) -> Any:
            if method == "GET" or "dryRun" in path or what.startswith(RENEWAL):
                return send(method, path, what, **options)
            with self.lock:  # one write after the other, so that they can be counted
                self.steps.append(what)
                due = len(self.steps) == self.limit
                if due and self.moment == "before":
                    self.die(what)
                self.lit = due and self.moment == "sent"
                answer = send(method, path, what, **options)
                if due:
                    self.die(what)
                return answer

        def getresponse(connection: Any, *words: Any, **options: Any) -> Any:
            if self.lit and self.lock.locked():
                self.die(self.steps[-1])
            return receive(connection, *words, **options)

        vars(transport)["request"] = request
        vars(cluster)["parallel"] = partial(parallel, width=1)  # so a number identifies one write
        HTTPConnection.getresponse = getresponse  # type: ignore[method-assign]

    def die(self, what: str) -> None:
        """End this process as SIGKILL does: at once, without closing anything."""
        self.say(what)
        os.kill(os.getpid(), signal.SIGKILL)


@attrs.frozen
class Outcome:
    """How a child process ended: its result, or the write at which it was killed."""

    killed: str | None = None
    result: Any = None
    steps: tuple[str, ...] = ()


def in_child(
    context: str, work: Callable[[Cluster], Any], limit: int = 0, moment: Moment = "after"
) -> Outcome:
    """Call a function with a cluster in a fork of this process, which dies at a write.

    Raises:
        RuntimeError: it failed in another way.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        code = 1
        try:

            def say(outcome: Outcome) -> None:
                os.write(writing, pickle.dumps(outcome))

            with connect(Settings(context=context)) as cluster:
                fuse = Fuse(limit, moment, lambda what: say(Outcome(killed=what)))
                fuse.attach(cluster)
                result = work(cluster)
                say(Outcome(result=result, steps=tuple(fuse.steps)))
            code = 0
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        said = pipe.read()
    _, status = os.waitpid(child, 0)
    if not said:
        raise RuntimeError(f"the child ended with {os.waitstatus_to_exitcode(status)}")
    outcome: Outcome = pickle.loads(said)
    return outcome

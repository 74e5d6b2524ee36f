"""Writes that an outage has held up, while another deploy may have begun: as HTTP requests."""

from __future__ import annotations

import threading
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import transport as resending
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.target import Target
from rigel_k8s.release import locking
from rigel_k8s.release.locking import hold, lease_ref
from rigel_k8s.release.types import DeployOptions
from tests.support.http_server import Exchange, HttpServer, serving
from tests.support.manifests import RELEASE, config
from tests.support.recorder import Recorder

LEASES = "/apis/coordination.k8s.io/v1/namespaces/n/leases"


@attrs.define
class ApiServer:
    """A Lease and a ConfigMap; each is away for the first so many writes.

    Attributes:
        successor: who takes the Lease while the ConfigMap is away, "" for no one.
    """

    away: dict[str, int]
    successor: str = ""
    lease: dict[str, Any] = attrs.field(factory=dict)

    def __call__(self, exchange: Exchange) -> None:
        request = exchange.request_
        kind = "lease" if "leases" in request.path else "config"
        if request.method == "PATCH" and self.away.get(kind, 0):
            self.away[kind] -= 1
            if self.successor:
                self.lease["spec"]["holderIdentity"] = self.successor
            exchange.hang_up()
        elif kind == "config":
            exchange.say(200, {"metadata": {"name": "c"}})
        else:
            self.answer_lease(exchange)

    def answer_lease(self, exchange: Exchange) -> None:
        """Answer as for a Lease that was made by the first request."""
        request = exchange.request_
        if request.method == "POST":
            self.lease = request.json
            self.lease["metadata"] |= {"uid": "u", "resourceVersion": "1"}
        taken = self.successor and self.lease["spec"]["holderIdentity"] == self.successor
        if request.method in ("PATCH", "DELETE") and taken:
            exchange.say(409, {"kind": "Status", "message": "it has been modified"})
        else:
            exchange.say(200, self.lease)


@pytest.fixture(autouse=True)
def unsure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each renewal counts as long ago; no thread renews meanwhile; pauses are short."""
    monkeypatch.setattr(locking, "SURE", 0.0)
    monkeypatch.setattr(locking, "RENEW", 60.0)
    monkeypatch.setattr(resending, "FIRST_PAUSE", 0.01)


def write_late(server: HttpServer) -> None:
    """Apply an object with the Lease held."""
    with Cluster(Target(server.url)) as cluster:
        cluster.endure(lambda _: None, threading.Event())
        with hold(cluster, RELEASE, DeployOptions(report=Recorder(), lock_timeout=0)):
            cluster.apply(config())


def list_writes(server: HttpServer) -> list[str]:
    """Return the methods of the writes, in order, with what they were about."""
    names = {True: "lease", False: "config"}
    return [f"{r.method} {names['leases' in r.path]}" for r in server.requests if r.method != "GET"]


def test_it_is_not_sent_where_the_lease_was_taken() -> None:
    """Or it would undo what the other deploy has applied since; the other one is named."""
    with serving(ApiServer({"config": 1}, successor="ann@far")) as server:
        with pytest.raises(ClusterError, match=r"Lease is lost: release demo is .* by ann@far"):
            write_late(server)
        assert list_writes(server).count("PATCH config") == 1


def test_it_is_sent_after_a_renewal() -> None:
    with serving(ApiServer({"config": 1})) as server:
        write_late(server)
        assert list_writes(server) == [
            "POST lease",
            "PATCH config",
            "PATCH lease",
            "PATCH config",
            "DELETE lease",
        ]


def test_a_renewal_that_is_sent_again_needs_no_other() -> None:
    """It is a write that comes late, too."""
    with serving(ApiServer({"config": 1, "lease": 2})) as server:
        write_late(server)
        assert list_writes(server).count("PATCH lease") == 3


def test_a_lease_is_removed_in_the_state_that_we_know() -> None:
    """Taking it over keeps the object, so its UID alone would fit."""
    with serving(ApiServer({})) as server:
        write_late(server)
        assert server.requests[-1].path == f"{LEASES}/{lease_ref(RELEASE).name}"
        conditions = server.requests[-1].json["preconditions"]
        assert conditions == {"uid": "u", "resourceVersion": "1"}

"""A local port follows its Service to another pod, and reports other errors as they are."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

from rigel_k8s.kube.forwarding import Forward
from rigel_stack.observing import Door

SERVICE = {
    "metadata": {"name": "grafana", "namespace": "monitoring"},
    "spec": {"selector": {"app": "grafana"}, "ports": [{"port": 3000}]},
}


class Pods:
    """A cluster with one ready pod."""

    def __init__(self) -> None:
        self.name = "grafana-1"
        self.forward = Forward()

    def list(self, *_: str, **__: Any) -> list[dict[str, Any]]:
        meta = {"name": self.name, "namespace": "monitoring", "uid": self.name}
        ready = {"conditions": [{"type": "Ready", "status": "True"}]}
        return [{"metadata": meta, "spec": {"containers": []}, "status": ready}]

    @contextmanager
    def port_forward(self, *_: Any) -> Iterator[Forward]:
        self.forward = Forward({3000: 4000})
        yield self.forward


def test_an_error_of_a_pod_that_is_there_is_passed_on() -> None:
    """The connection is not made again, which would end the others."""
    cluster = Pods()
    door = Door(cast(Any, cluster), SERVICE)
    door.open(4000)
    assert list(door.look()) == []
    cluster.forward.errors.append("refused")
    assert list(door.look()) == ["grafana: refused"]


def test_a_pod_that_has_ended_is_followed_by_the_next() -> None:
    """At the same address."""
    cluster = Pods()
    door = Door(cast(Any, cluster), SERVICE)
    door.open(4000)
    cluster.forward.errors.append("gone")
    cluster.name = "grafana-2"
    text = "grafana is reachable again at http://127.0.0.1:4000, in grafana-2"
    assert list(door.look()) == [text]

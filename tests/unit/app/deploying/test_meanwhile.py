"""What is looked at while the registries are asked for digests."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any

import pytest

from rigel_k8s.app.deploying import prepare as orchestration_release
from rigel_k8s.app.deploying.prepare import Preparation, prepare
from rigel_k8s.settings import Application, Settings
from tests.support.options import options


class Cluster:
    """An empty cluster that can be asked for its nodes as soon as somebody else says so."""

    namespace = "robots"

    def __init__(self, ready: Callable[[], object]) -> None:
        self.ready = ready

    def nodes(self) -> list[dict[str, Any]]:
        self.ready()
        return []

    def list(self, *_: Any, **__: Any) -> list[dict[str, Any]]:
        return []

    def parallel(self, function: Callable[..., Any], items: Iterable[Any]) -> list[Any]:
        return list(map(function, items))


def prepared(network: object, cluster: Cluster, *, preflight: bool) -> Preparation:
    raw = {"image": "app@sha256:" + "ab" * 32, "network": network, "nodes": {"talker": {}}}
    return prepare(
        options(raw),
        raw,
        Application("jazzy"),
        Settings(),
        cluster,  # type: ignore[arg-type]
        providers={},
        preflight=preflight,
    )


def test_the_network_is_looked_at_while_registries_are_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A registry far away is slow, and so are machines: nobody waits for one after the other."""
    both = threading.Barrier(2)

    def pins(*_: Any) -> dict[str, str]:
        both.wait(60)
        return {}

    monkeypatch.setattr(orchestration_release, "pins", pins)
    assert prepared("host", Cluster(lambda: both.wait(60)), preflight=True).findings is not None


@pytest.mark.parametrize(
    ("network", "preflight"),
    [(None, True), ("host", False), ({"mode": "host", "install": True}, True)],
)
def test_it_is_looked_at_early_only_where_it_is_as_it_will_be(
    network: object,
    preflight: bool,  # noqa: FBT001 - a case's value
) -> None:
    """`render` and `diff` do not look; what is installed first is looked at afterwards."""
    cluster = Cluster(lambda: pytest.fail("the cluster was asked"))
    assert prepared(network, cluster, preflight=preflight).findings is None

"""A server instead of an API server, and the client that speaks to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, TypeAlias

import attrs
import pytest

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.target import Target
from rigel_k8s.objects.refs import ObjectRef
from tests.support.http_server import Exchange, HttpServer, serving

REF = ObjectRef("v1", "ConfigMap", "robot", "c")
MANIFEST = {
    "apiVersion": "v1",
    "kind": "ConfigMap",
    "metadata": {"name": "c", "namespace": "robot"},
    "data": {"a": "1"},
}
Serve: TypeAlias = Callable[..., tuple[Cluster, HttpServer]]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Return what starts a server that answers as a function says, with a client of it.

    Keywords besides `tls` and `base` (a path of the URL) are the target's.
    """
    with ExitStack() as stack:

        def start(
            answer: Callable[[Exchange], None], *, tls: Any = None, base: str = "", **target: Any
        ) -> tuple[Cluster, HttpServer]:
            server = stack.enter_context(serving(answer, tls=tls))
            given = attrs.evolve(Target(f"{server.url}{base}", "test"), **target)
            return stack.enter_context(Cluster(given)), server

        yield start

"""Around a deploy: how long the graph may stay worse."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import attrs
import pytest

from rigel_graph.hooks import GraphHooks
from rigel_k8s.app.expectations import Expectation
from rigel_k8s.app.options import RollbackOn
from rigel_k8s.objects.scalars import Duration, Range

FAST = Range("8..12")


@pytest.mark.parametrize(
    ("asked", "expected", "limit"),
    [
        (None, None, None),
        (RollbackOn(graph_worse=False), Expectation(rate=FAST), None),
        (None, Expectation(rate=FAST, otherwise="rollback"), 60.0),
        (None, Expectation(gap=Duration("1s"), otherwise="rollback"), 70.0),
        (RollbackOn(graph_worse=True), None, 60.0),
        (RollbackOn(graph_worse=True, within=Duration("2m")), None, 120.0),
    ],
)
def test_the_graph_may_stay_worse_as_long_as_is_said(
    asked: RollbackOn | None, expected: Expectation | None, limit: float | None
) -> None:
    """If nothing requests a rollback, forever; the documentation of `within` has the default."""
    options = SimpleNamespace(rollback_on=asked, expect={"/scan": expected} if expected else {})
    hooks = GraphHooks(options=cast(Any, options), ros=cast(Any, None), now=False)
    assert hooks.limit == limit
    assert "(default 60s)" in attrs.fields(RollbackOn).within.metadata["doc"]

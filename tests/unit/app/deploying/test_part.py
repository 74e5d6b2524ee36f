"""An application as a part of a job: how long its graph may stay worse."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import attrs
import pytest

from rigel_k8s.app.deploying.part import ApplicationPart
from rigel_k8s.app.options import RollbackOn
from rigel_k8s.objects.scalars import Duration


@pytest.mark.parametrize(
    ("asked", "limit"),
    [
        (None, None),
        (RollbackOn(graph_worse=False), None),
        (RollbackOn(graph_worse=True), 60.0),
        (RollbackOn(graph_worse=True, within=Duration("2m")), 120.0),
    ],
)
def test_the_graph_may_stay_worse_as_long_as_is_said(
    asked: RollbackOn | None, limit: float | None
) -> None:
    """Without `rollback_on` forever; the documentation of `within` has the default."""
    options = SimpleNamespace(rollback_on=asked)
    part: Any = SimpleNamespace(prepared=SimpleNamespace(options=options))
    assert cast(Any, ApplicationPart.limit).fget(part) == limit
    assert "(default 60s)" in attrs.fields(RollbackOn).within.metadata["doc"]

"""A dashboard's queries, asked as Grafana asks them: the variables filled in, by kind of source."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pytest

from rigel_stack.boards import dashboards

from .conftest import Watch

#: As Grafana fills them in: all values chosen, by `allValue` or one after the other.
VALUES = {
    "namespace": ".+",
    "application": ".+",
    "ros_node": ".*",
    "topic": ".*",
    "node": ".+",
    "level": ".*",
    "search": "",
    "__rate_interval": "1m",
    "__auto": "1m",
    "__range": "15m",
}


def questions() -> Iterator[Any]:
    """Yield (panel, target) of all dashboards, with a name for each."""
    for name, text in dashboards().items():
        board = name.removesuffix(".json")
        for panel in json.loads(text)["panels"]:
            for target in panel.get("targets", []):
                yield pytest.param(panel, target, id=f"{board}: {panel['title']} {target['refId']}")


def filled(expr: str, values: Mapping[str, str] = VALUES) -> str:
    """Return a query with the variables filled in; a variable without a value is an error."""
    return re.sub(r"\$\{?(\w+)\}?", lambda found: values[found[1]], expr)


def asked(
    watch: Watch, target: Mapping[str, Any], values: Mapping[str, str] = VALUES
) -> Sequence[Any]:
    """Return what a panel's datasource answers, as Grafana asks it."""
    expr = filled(target["expr"], values)
    ask = watch.loki if target["datasource"]["type"] == "loki" else watch.prometheus
    now = time.time()
    if target.get("instant") or target.get("queryType") == "instant":
        answer = ask("query", query=expr, time=now)
    else:
        answer = ask("query_range", query=expr, start=now - 900, end=now, step=15)
    return list(answer["result"])

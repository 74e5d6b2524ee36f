"""Every panel's query, its variables filled in, answered by the running Prometheus and Loki."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from rigel_k8s.boards import dashboards
from rigel_k8s.deploy.types import ObjectRef

from .conftest import Troubled, until

pytestmark = pytest.mark.cluster

#: As Grafana fills them in: all values chosen, by `allValue` or one after the other.
VALUES = {
    "namespace": ".+",
    "application": "(sick|forgetful)",
    "ros_node": ".*",
    "topic": ".*",
    "node": ".+",
    "level": ".*",
    "search": "",
    "__rate_interval": "1m",
    "__auto": "1m",
    "__range": "15m",
}

#: Panels without data here, and why. What is not named must answer.
EMPTY = {
    "Volumes": "the local cluster's volumes are directories, which the kubelet does not measure",
}


def questions() -> Iterator[Any]:
    """Yield (dashboard, panel, target) with a name for each."""
    for name, text in dashboards().items():
        for panel in json.loads(text)["panels"]:
            for target in panel.get("targets", []):
                title = f"{name.removesuffix('.json')}: {panel['title']} {target['refId']}"
                yield pytest.param(panel["title"], target, id=title)


def filled(expr: str) -> str:
    """Return a query with the variables filled in; a variable without a value is an error."""
    return re.sub(r"\$\{?(\w+)\}?", lambda found: VALUES[found[1]], expr)


def asked(troubled: Troubled, target: dict[str, Any]) -> Sequence[Any]:
    """Return what a panel's datasource answers, as Grafana asks it."""
    watch, expr = troubled.watch, filled(target["expr"])
    ask = watch.loki if target["datasource"]["type"] == "loki" else watch.prometheus
    now = time.time()
    if target.get("instant") or target.get("queryType") == "instant":
        answer = ask("query", query=expr, time=now)
    else:
        answer = ask("query_range", query=expr, start=now - 900, end=now, step=15)
    return list(answer["result"])


@pytest.mark.parametrize(("title", "target"), list(questions()))
def test_every_panel_answers(title: str, target: dict[str, Any], troubled: Troubled) -> None:
    """A roboticist who opens a dashboard of a running application sees no empty panel."""
    if title in EMPTY:
        asked(troubled, target)  # it is answered, with nothing
        return
    until(lambda: asked(troubled, target), f"an answer to {filled(target['expr'])}", 120)


def test_variables_offer_what_is_there(troubled: Troubled) -> None:
    """The namespaces, applications, ROS nodes, topics and machines of the cluster can be chosen."""
    offered = {}
    for text in dashboards().values():
        for variable in json.loads(text)["templating"]["list"]:
            if variable["type"] == "query":
                query = filled(variable["query"]["query"])
                match, label = re.fullmatch(r"label_values\((.+), (\w+)\)", query).groups()
                path = f"label/{label}/values"
                values = troubled.watch.prometheus(path, **{"match[]": match})
                offered.setdefault(variable["name"], set()).update(values)
    assert {"sick", "forgetful"} <= offered["application"]
    assert "rigel-observability" not in offered["application"]
    assert {troubled.sick, troubled.forgetful} <= offered["namespace"]
    assert {"/sensor", "/listener", "/victim", "/talker"} <= offered["ros_node"]
    assert {"/scan", "/nobody"} <= offered["topic"]
    assert offered["node"]


def test_roll_outs_become_marks(troubled: Troubled, cluster: Any) -> None:
    """A changed Deployment is a mark in the curves, by its workload's name; it calls nobody."""
    model = json.loads(dashboards()["rigel-applications.json"])
    (marks,) = model["annotations"]["list"]
    ref = ObjectRef("apps/v1", "Deployment", troubled.sick, "listener")
    stamp = {"metadata": {"annotations": {"kubectl.kubernetes.io/restartedAt": "now"}}}
    cluster.patch(ref, {"spec": {"template": stamp}})
    target = {"expr": marks["expr"], "datasource": {"type": "prometheus"}}

    def seen() -> bool:
        found = asked(troubled, target)
        return any(series["metric"]["workload"] == "listener" for series in found)

    until(seen, "the mark of listener's roll-out")
    up = f'ros_node_up{{namespace="{troubled.sick}", ros_node="/listener"}} == 1'
    until(lambda: troubled.watch.now(up), "/listener is up again")
    called = f'ALERTS{{alertstate="firing", namespace="{troubled.sick}", workload="listener"}}'
    assert troubled.watch.now(f"max_over_time({called}[10m])") == []

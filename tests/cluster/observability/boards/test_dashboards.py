"""Every panel's query, its variables filled in, answered by the running Prometheus and Loki."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_stack.boards import dashboards

from . import asking
from .conftest import Troubled, until

pytestmark = pytest.mark.cluster

#: The applications of these tests, chosen.
VALUES = {**asking.VALUES, "application": "(sick|forgetful)"}

#: Panels without data here, and why. What is not named must answer.
EMPTY = {
    "Volumes": "the local cluster's volumes are directories, which the kubelet does not measure",
}


@pytest.mark.parametrize(("panel", "target"), list(asking.questions()))
def test_every_panel_answers(
    panel: dict[str, Any], target: dict[str, Any], troubled: Troubled
) -> None:
    """A roboticist who opens a dashboard of a running application sees no empty panel."""
    if panel["title"] in EMPTY:
        asking.asked(troubled.watch, target, VALUES)  # it is answered, with nothing
        return
    what = f"an answer to {asking.filled(target['expr'], VALUES)}"
    until(lambda: asking.asked(troubled.watch, target, VALUES), what, 120)


def test_variables_offer_what_is_there(troubled: Troubled) -> None:
    """The namespaces, applications, ROS nodes, topics and machines of the cluster can be chosen."""
    offered = {}
    for text in dashboards().values():
        for variable in json.loads(text)["templating"]["list"]:
            if variable["type"] == "query":
                query = asking.filled(variable["query"]["query"], VALUES)
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
        found = asking.asked(troubled.watch, target, VALUES)
        return any(series["metric"]["workload"] == "listener" for series in found)

    until(seen, "the mark of listener's roll-out")
    up = f'ros_node_up{{namespace="{troubled.sick}", ros_node="/listener"}} == 1'
    until(lambda: troubled.watch.now(up), "/listener is up again")
    called = f'ALERTS{{alertstate="firing", namespace="{troubled.sick}", workload="listener"}}'
    assert troubled.watch.now(f"max_over_time({called}[10m])") == []

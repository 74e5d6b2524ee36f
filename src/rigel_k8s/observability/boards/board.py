"""A whole dashboard: rows of panels laid into Grafana's grid, with variables, links and roll-outs.

It knows what all our dashboards share, and none of them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

import attrs

from rigel_k8s.observability.boards import LOGS, METRICS
from rigel_k8s.observability.boards.panels import SOURCES, Json, Panel

__all__ = ["APPLICATION", "NAMESPACE", "ROS_NODE", "Board", "Row", "choice"]

#: Grafana's grid is so many columns wide.
WIDTH = 24
#: Dashboards of ours, by which they find each other.
TAG = "rigel-k8s"
#: The model's version that these files are written for: Grafana 10.4's, which later ones read.
SCHEMA = 39
#: Releases that carry applications, and are none.
NOT_APPLICATIONS = "rigel-observability|rigel-network"

REFRESH_ON_TIME = 2


@attrs.frozen
class Row:
    """Panels beside each other under a title, each with its share of the 24 columns."""

    title: str
    panels: Sequence[tuple[int, Panel]]
    height: int = 8


@attrs.frozen
class Board:
    """A dashboard.

    Attributes:
        uid: part of every link to it: it never changes.
        variables: what its queries are narrowed by, in order.
        rollouts: whether roll-outs of applications are marked in its curves.
    """

    uid: str
    title: str
    about: str
    rows: Sequence[Row]
    variables: Sequence[Json]
    rollouts: bool = attrs.field(default=True, kw_only=True)

    def text(self) -> str:
        """Return the dashboard's JSON, as it is kept in a file."""
        return json.dumps(self.model(), indent=2, ensure_ascii=False) + "\n"

    def model(self) -> Json:
        """Return the dashboard in Grafana's JSON model."""
        return {
            "uid": self.uid,
            "title": self.title,
            "description": self.about,
            "tags": [TAG, "ros"],
            "schemaVersion": SCHEMA,
            "editable": True,
            "graphTooltip": 1,
            "timezone": "browser",
            "time": {"from": "now-1h", "to": "now"},
            "refresh": "30s",
            "links": [others()],
            "annotations": {"list": [rollouts()] if self.rollouts else []},
            "templating": {"list": [*self.variables, *datasources()]},
            "panels": list(laid(self.rows)),
        }


def laid(rows: Sequence[Row]) -> Iterator[Json]:
    """Return the panels with their ids and places, each row of them under its title."""
    top, number = 0, 0
    for row in rows:
        number += 1
        place = {"x": 0, "y": top, "w": WIDTH, "h": 1}
        head: Json = {"id": number, "type": "row", "title": row.title, "collapsed": False}
        yield {**head, "gridPos": place, "panels": []}
        left, top = 0, top + 1
        for width, panel in row.panels:
            if left + width > WIDTH:
                left, top = 0, top + row.height
            number += 1
            place = {"x": left, "y": top, "w": width, "h": row.height}
            yield {"id": number, "gridPos": place, **panel.model}
            left += width
        top += row.height


def others() -> Json:
    """Return the menu of our other dashboards; time and variables go along."""
    return {
        "type": "dashboards",
        "title": "ROS on Kubernetes",
        "tags": [TAG],
        "asDropdown": False,
        "includeVars": True,
        "keepTime": True,
        "targetBlank": False,
        "icon": "external link",
        "tooltip": "",
        "url": "",
    }


def rollouts() -> Json:
    """Return the marks of roll-outs: a Deployment's wish changed.

    The query stands beside `target`'s place: Grafana takes it from there in all versions.
    """
    changed = (
        "sum by (namespace, application, workload) (changes("
        'workload:kube_deployment_metadata_generation:max{namespace=~"$namespace", '
        'application=~"$application"}[1m])) > 0'
    )
    return {
        "name": "Roll-outs",
        "datasource": SOURCES["metrics"],
        "enable": True,
        "hide": False,
        "iconColor": "blue",
        "expr": changed,
        "step": "60s",
        "titleFormat": "Roll-out of {{workload}}",
        "textFormat": "{{application}} in {{namespace}}",
        "tagKeys": "application,workload",
    }


def datasources() -> list[Json]:
    """Return the variables that choose where metrics and logs come from."""
    return [
        datasource("metrics", "Metrics from", "prometheus", METRICS),
        datasource("logs", "Logs from", "loki", LOGS),
    ]


def datasource(name: str, label: str, kind: str, uid: str) -> Json:
    """Return a variable of datasources; a Grafana without that UID takes its first of the kind."""
    return {
        "type": "datasource",
        "name": name,
        "label": label,
        "query": kind,
        "regex": "",
        "hide": 0,
        "refresh": 1,
        "multi": False,
        "includeAll": False,
        "current": {"text": uid, "value": uid},
        "options": [],
    }


def choice(name: str, label: str, query: str, everything: str | None) -> Json:
    """Return a variable whose values are a label's; all of them at first.

    Args:
        everything: the regular expression that stands for all; None lists the values.
    """
    model: Json = {
        "type": "query",
        "name": name,
        "label": label,
        "datasource": SOURCES["metrics"],
        "query": {"query": query, "refId": name},
        "regex": "",
        "hide": 0,
        "refresh": REFRESH_ON_TIME,
        "sort": 1,
        "multi": True,
        "includeAll": True,
        "current": {"text": "All", "value": "$__all"},
        "options": [],
    }
    return model | ({} if everything is None else {"allValue": everything})


NAMESPACE = choice(
    "namespace", "Namespace", "label_values(pod:rigel_identity:info, namespace)", ".+"
)
APPLICATION = choice(
    "application",
    "Application",
    'label_values(pod:rigel_identity:info{namespace=~"$namespace", '
    f'application!~"{NOT_APPLICATIONS}"}}, application)',
    None,
)
ROS_NODE = choice(
    "ros_node",
    "ROS node",
    'label_values({__name__=~"pod:rigel_identity:info|ros_node_up", namespace=~"$namespace", '
    'application=~"$application", ros_node!=""}, ros_node)',
    ".*",
)

"""A whole dashboard: rows of panels, variables, links and roll-outs.

It has what all our dashboards share, and depends on none of them. Grafana's builders lay out the
grid.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import attrs
from grafana_foundation_sdk.builders import dashboard as build
from grafana_foundation_sdk.cog.builder import Builder
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models import dashboard as model

from rigel_stack.boards import LOGS, METRICS
from tools.boards.panels import SOURCES, Panel

#: The tag of our dashboards, by which they link to each other.
TAG = "rigel-k8s"
#: The model's version that these files are written for: Grafana 10.4's, which later ones read.
SCHEMA = 39
#: Releases that are not applications, but serve them.
NOT_APPLICATIONS = "rigel-observability|rigel-network"

ALL = model.VariableOption(text="All", value="$__all")

Variable = Builder[model.VariableModel]


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
        variables: the choices that its queries use, in order.
        rollouts: whether roll-outs of applications are marked in its curves.
    """

    uid: str
    title: str
    about: str
    rows: Sequence[Row]
    variables: Sequence[Variable]
    rollouts: bool = attrs.field(default=True, kw_only=True)

    def text(self) -> str:
        """Return the dashboard's JSON, as it is kept in a file."""
        return json.dumps(self.build(), cls=JSONEncoder, indent=2, ensure_ascii=False) + "\n"

    def build(self) -> model.Dashboard:
        """Return the dashboard in Grafana's model."""
        made = (
            build.Dashboard(self.title)
            .uid(self.uid)
            .description(self.about)
            .tags([TAG, "ros"])
            .editable()
            .tooltip(model.DashboardCursorSync.CROSSHAIR)
            .timezone("browser")
            .time("now-1h", "now")
            .refresh("30s")
            .link(other_boards())
            .annotations([RollOuts()] if self.rollouts else [])
            .variables([*self.variables, *datasources()])
        )
        number = 0
        for row in self.rows:
            number += 1
            made.with_row(build.Row(row.title).id(number))
            for width, panel in row.panels:
                number += 1
                made.with_panel(panel.id(number).span(width).height(row.height))
        result = made.build()
        result.schema_version = SCHEMA
        return result


def other_boards() -> build.DashboardLink:
    """Return the menu of our other dashboards; the links keep time and variables."""
    return (
        build.DashboardLink("ROS on Kubernetes")
        .type(model.DashboardLinkType.DASHBOARDS)
        .tags([TAG])
        .icon("external link")
        .include_vars(True)
        .keep_time(True)
    )


class RollOuts(Builder[model.AnnotationQuery]):
    """The marks of roll-outs: a Deployment's generation changed."""

    def build(self) -> model.AnnotationQuery:
        """Return them."""
        changed = (
            "sum by (namespace, application, workload) (changes("
            'workload:kube_deployment_metadata_generation:max{namespace=~"$namespace", '
            'application=~"$application"}[1m])) > 0'
        )
        return PrometheusMarks(
            name="Roll-outs", datasource=SOURCES["metrics"], icon_color="blue", expr=changed
        )


class PrometheusMarks(model.AnnotationQuery):
    """Marks with the fields that are Prometheus' own, which Grafana's schema leaves open.

    The query is beside `target`: all versions of Grafana read it there.
    """

    def to_json(self) -> dict[str, object]:
        """Return Grafana's JSON."""
        return super().to_json() | {
            "step": "60s",
            "titleFormat": "Roll-out of {{workload}}",
            "textFormat": "{{application}} in {{namespace}}",
            "tagKeys": "application,workload",
        }


def datasources() -> list[Variable]:
    """Return the variables that choose the datasources of metrics and logs."""
    return [
        datasource("metrics", "Metrics from", "prometheus", METRICS),
        datasource("logs", "Logs from", "loki", LOGS),
    ]


def datasource(name: str, label: str, kind: str, uid: str) -> Variable:
    """Return a variable of datasources; without that UID, Grafana uses the first of the kind."""
    chosen = model.VariableOption(text=uid, value=uid)
    return build.DatasourceVariable(name).label(label).type(kind).current(chosen)


def choice(name: str, label: str, query: str, everything: str | None) -> Variable:
    """Return a variable whose values are a label's; all of them at first.

    Args:
        everything: the regular expression that stands for all; None lists the values.
    """
    made = (
        build.QueryVariable(name)
        .label(label)
        .datasource(SOURCES["metrics"])
        .query({"query": query, "refId": name})
        .refresh(model.VariableRefresh.ON_TIME_RANGE_CHANGED)
        .sort(model.VariableSort.ALPHABETICAL_ASC)
        .multi(True)
        .include_all(True)
        .current(ALL)
    )
    return made if everything is None else made.all_value(everything)


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

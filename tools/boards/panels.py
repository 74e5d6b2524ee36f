"""Grafana's panels as all our dashboards use them: their queries, and the text without a result.

Grafana's builders do the rest. The queries are in the modules of the dashboards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import attrs
from grafana_foundation_sdk.builders import (
    common,
    dashboard,
    logs,
    loki,
    prometheus,
    stat,
    statetimeline,
    timeseries,
)
from grafana_foundation_sdk.builders import table as tables
from grafana_foundation_sdk.cog.builder import Builder
from grafana_foundation_sdk.models import common as words
from grafana_foundation_sdk.models import dashboard as model
from grafana_foundation_sdk.models.prometheus import PromQueryFormat

#: The datasources are variables, so those of any Grafana can be chosen.
SOURCES = {
    "metrics": model.DataSourceRef(type_val="prometheus", uid="${metrics}"),
    "logs": model.DataSourceRef(type_val="loki", uid="${logs}"),
}
GREEN, YELLOW, RED = "green", "#EAB839", "red"

Panel = stat.Panel | timeseries.Panel | statetimeline.Panel | tables.Panel | logs.Panel
P = TypeVar("P", stat.Panel, timeseries.Panel, statetimeline.Panel, tables.Panel, logs.Panel)


@attrs.frozen
class Query:
    """One query to a datasource.

    Attributes:
        legend: Grafana's template of a series' name, `{{ros_node}}`.
        source: `metrics` (PromQL) or `logs` (LogQL).
        now: whether only the latest value is needed, not its history.
    """

    expr: str
    legend: str = ""
    source: str = "metrics"
    now: bool = attrs.field(default=False, kw_only=True)

    def target(self, ref: str, *, rows: bool = False) -> loki.Dataquery | prometheus.Dataquery:
        """Return the panel's target; `rows` requests a table of labels instead of series."""
        made: loki.Dataquery | prometheus.Dataquery
        if self.source == "logs":
            made = loki.Dataquery().query_type("instant" if self.now else "range")
        else:
            form = PromQueryFormat.TABLE if rows else PromQueryFormat.TIME_SERIES
            made = prometheus.Dataquery().format(form)
            made = made.instant() if self.now else made.range()
        made = made.expr(self.expr).ref_id(ref).datasource(SOURCES[self.source])
        return made.legend_format(self.legend) if self.legend else made


def begin(panel: P, title: str, about: str, queries: Sequence[Query]) -> P:
    """Return a panel with what all have in common; `about` explains to readers what it shows."""
    rows = isinstance(panel, tables.Panel)
    panel = panel.title(title).description(about).datasource(SOURCES[queries[0].source])
    for ref, query in zip("ABCDEFGH", queries, strict=False):
        panel = panel.with_target(query.target(ref, rows=rows))
    return panel


def thresholds(yellow: float | None, red: float | None) -> dashboard.ThresholdsConfig:
    """Return the colors of a value that should be small."""
    steps = [(None, GREEN), (yellow, YELLOW), (red, RED)]
    kept = [steps[0], *[step for step in steps[1:] if step[0] is not None]]
    return (
        dashboard.ThresholdsConfig()
        .mode(model.ThresholdsMode.ABSOLUTE)
        .steps([model.Threshold(value=value, color=colour) for value, colour in kept])
    )


def link(title: str, url: str, *, new_tab: bool = False) -> dashboard.DashboardLink:
    """Return a link from a value to another page."""
    return dashboard.DashboardLink(title).url(url).target_blank(new_tab)


def links_of(links: Sequence[dashboard.DashboardLink]) -> list[model.DashboardLink]:
    """Return links as the value of an override's property."""
    return [one.build() for one in links]


def value_names(names: Mapping[int, tuple[str, str]]) -> list[model.ValueMapping]:
    """Return mappings of values to a word and a colour."""
    options = {
        str(value): model.ValueMappingResult(text=text, color=colour, index=index)
        for index, (value, (text, colour)) in enumerate(names.items())
    }
    return [model.ValueMap(options=options)]


def number(
    title: str,
    about: str,
    query: Query,
    *,
    unit: str = "none",
    empty: str,
    yellow: float | None = None,
    red: float | None = None,
    links: Sequence[dashboard.DashboardLink] = (),
) -> stat.Panel:
    """Return one big number; `empty` is the text if there is no result."""
    mode = words.BigValueColorMode
    return (
        begin(stat.Panel(), title, about, [query])
        .unit(unit)
        .no_value(empty)
        .thresholds(thresholds(yellow, red))
        .data_links(list(links))
        .reduce_options(common.ReduceDataOptions().calcs(["lastNotNull"]).fields("").values(False))
        .color_mode(mode.VALUE if yellow is None and red is None else mode.BACKGROUND)
        .graph_mode(words.BigValueGraphMode.NONE)
        .text_mode(words.BigValueTextMode.AUTO)
    )


def curves(
    title: str,
    about: str,
    queries: Sequence[Query],
    *,
    unit: str,
    empty: str,
    least: float | None = 0,
    most: float | None = None,
    red: float | None = None,
    stacked: bool = False,
    links: Sequence[dashboard.DashboardLink] = (),
    special: Mapping[str, Sequence[dashboard.DashboardLink]] | None = None,
) -> timeseries.Panel:
    """Return values over time, a curve for each series.

    Args:
        red: a limit, drawn as a line.
        special: other links for the series of a query, by its refId.
    """
    limit, stack = words.GraphThresholdsStyleMode, words.StackingMode
    panel = (
        begin(timeseries.Panel(), title, about, queries)
        .unit(unit)
        .no_value(empty)
        .data_links(list(links))
        .line_width(1)
        .fill_opacity(20 if stacked else 5)
        .show_points(words.VisibilityMode.NEVER)
        .stacking(common.StackingConfig().mode(stack.NORMAL if stacked else stack.NONE).group("A"))
        .thresholds_style(
            common.GraphThresholdsStyleConfig().mode(limit.OFF if red is None else limit.LINE)
        )
        .legend(
            common.VizLegendOptions()
            .display_mode(words.LegendDisplayMode.TABLE)
            .placement(words.LegendPlacement.RIGHT)
            .show_legend(True)
            .calcs(["lastNotNull", "max"])
        )
        .tooltip(
            common.VizTooltipOptions()
            .mode(words.TooltipDisplayMode.MULTI)
            .sort(words.SortOrder.DESCENDING)
        )
    )
    if least is not None:
        panel.min(least)
    if most is not None:
        panel.max(most)
    if unit == "none":
        panel.decimals(0)  # whole numbers
    if red is not None:
        panel.thresholds(thresholds(None, red))
    for ref, own in (special or {}).items():
        panel.override_by_query(ref, [model.DynamicConfigValue("links", links_of(own))])
    return panel


def states(
    title: str,
    about: str,
    queries: Sequence[Query],
    *,
    names: Mapping[int, tuple[str, str]],
    empty: str,
    links: Sequence[dashboard.DashboardLink] = (),
) -> statetimeline.Panel:
    """Return bars over time, one for each series, coloured by what its value means."""
    return (
        begin(statetimeline.Panel(), title, about, queries)
        .no_value(empty)
        .mappings(value_names(names))
        .data_links(list(links))
        .fill_opacity(75)
        .line_width(0)
        .merge_values(True)
        .show_value(words.VisibilityMode.NEVER)
        .align_value(words.TimelineValueAlignment.LEFT)
        .row_height(0.8)
        .per_page(200)  # all of them: the exporter counts no more nodes
        .legend(
            common.VizLegendOptions()
            .display_mode(words.LegendDisplayMode.LIST)
            .placement(words.LegendPlacement.BOTTOM)
            .show_legend(True)
        )
        .tooltip(
            common.VizTooltipOptions()
            .mode(words.TooltipDisplayMode.SINGLE)
            .sort(words.SortOrder.NONE)
        )
    )


def table(
    title: str,
    about: str,
    queries: Sequence[Query],
    *,
    columns: Mapping[str, str],
    empty: str,
    special: Mapping[str, Mapping[str, Any]] | None = None,
    sort: str | None = None,
) -> tables.Panel:
    """Return a table of the latest values, a row for each set of labels.

    Args:
        columns: labels, and `Value #A` of the first query, by their titles, in their order;
            others are not shown.
        special: properties (unit, mappings, links) by a column's title.
        sort: the title of the column that the rows are sorted by, the greatest first.
    """
    order = name_columns(columns, single=len(queries) == 1, source=queries[0].source)
    organize = {
        "includeByName": dict.fromkeys(order, True),
        "indexByName": {name: index for index, name in enumerate(order)},
        "renameByName": order,
    }
    by: list[Builder[words.TableSortByFieldState]] = []
    if sort:
        by.append(common.TableSortByFieldState().display_name(sort).desc(True))
    panel = (
        begin(tables.Panel(), title, about, queries)
        .no_value(empty)
        .show_header(True)
        .sort_by(by)
        .transformations([*join_rows(queries), transformation("organize", organize)])
    )
    for name, own in (special or {}).items():
        panel.override_by_name(name, [model.DynamicConfigValue(k, v) for k, v in own.items()])
    return panel


def name_columns(columns: Mapping[str, str], *, single: bool, source: str) -> dict[str, str]:
    """Return the columns as Grafana names them: a single query's is `Value`, Loki's may be."""
    names = {}
    for name, title in columns.items():
        both = [name, "Value"] if source == "logs" and name == "Value #A" else [name]
        for one in ["Value"] if single and source == "metrics" and name == "Value #A" else both:
            names[one] = title
    return names


def join_rows(queries: Sequence[Query]) -> list[model.DataTransformerConfig]:
    """Return the steps from answers to rows: Loki gives a frame for each series."""
    merge = transformation("merge", {})
    if queries[0].source == "logs":
        return [transformation("labelsToFields", {"mode": "columns"}), merge]
    return [merge] if len(queries) > 1 else []


def transformation(kind: str, options: Mapping[str, Any]) -> model.DataTransformerConfig:
    """Return a step from answers to what is shown."""
    return model.DataTransformerConfig(id_val=kind, options=options)


def lines(title: str, about: str, query: Query) -> logs.Panel:
    """Return the log lines themselves, the newest first."""
    return (
        begin(logs.Panel(), title, about, [query])
        .show_time(True)
        .show_labels(False)
        .show_common_labels(False)
        .wrap_log_message(True)
        .prettify_log_message(False)
        .enable_log_details(True)
        .dedup_strategy(words.LogsDedupStrategy.NONE)
        .sort_order(words.LogsSortOrder.DESCENDING)
    )

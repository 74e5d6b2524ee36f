"""Grafana's panels in few words: what is asked, in which unit, and what an empty answer means.

It knows Grafana's JSON model and no query: those stand in the modules that describe a dashboard.
Ids, places and refIds are counted, never written by hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs

__all__ = [
    "Json",
    "Panel",
    "Query",
    "curves",
    "lines",
    "number",
    "states",
    "table",
    "value_names",
]

Json = dict[str, Any]

#: The datasources are variables, so that any Grafana's own can be chosen.
SOURCES = {
    "metrics": {"type": "prometheus", "uid": "${metrics}"},
    "logs": {"type": "loki", "uid": "${logs}"},
}
GREEN, YELLOW, RED = "green", "#EAB839", "red"


@attrs.frozen
class Query:
    """One question to a datasource.

    Attributes:
        legend: Grafana's template of a series' name, `{{ros_node}}`.
        source: `metrics` (PromQL) or `logs` (LogQL).
        now: whether only the latest value is wanted, not its history.
    """

    expr: str
    legend: str = ""
    source: str = "metrics"
    now: bool = attrs.field(default=False, kw_only=True)

    def target(self, ref: str, *, rows: bool = False) -> Json:
        """Return the panel's target; `rows` asks for a table of labels instead of series."""
        how: Json = {"queryType": "instant" if self.now else "range"}
        if self.source == "metrics":
            how = {"instant": self.now, "range": not self.now}
            how |= {"format": "table" if rows else "time_series"}
        target = {"refId": ref, "datasource": SOURCES[self.source], "expr": self.expr, **how}
        return target | ({"legendFormat": self.legend} if self.legend else {})


@attrs.frozen
class Panel:
    """A panel without its place.

    Attributes:
        model: its JSON but id and gridPos.
        queries: what it asks, for those who look at queries only.
    """

    model: Json
    queries: Sequence[Query] = ()


def made(kind: str, title: str, about: str, queries: Sequence[Query], **model: Any) -> Panel:
    """Return a panel of Grafana's type `kind`; `about` tells a reader what it shows."""
    rows = kind == "table"
    targets = [
        query.target(chr(ord("A") + index), rows=rows) for index, query in enumerate(queries)
    ]
    head = {"type": kind, "title": title, "description": about}
    source = {"datasource": SOURCES[queries[0].source], "targets": targets}
    return Panel({**head, **source, **model}, tuple(queries))


def thresholds(steps: Sequence[tuple[float | None, str]]) -> Json:
    """Return colours from values on: [(None, green), (1, red)]."""
    return {
        "mode": "absolute",
        "steps": [{"value": value, "color": colour} for value, colour in steps],
    }


def warn(yellow: float | None, red: float | None) -> list[tuple[float | None, str]]:
    """Return the steps of a value that shall be small."""
    steps: list[tuple[float | None, str]] = [(None, GREEN)]
    steps += [(yellow, YELLOW)] if yellow is not None else []
    return steps + ([(red, RED)] if red is not None else [])


def link(title: str, url: str) -> Json:
    """Return a link from a value to another page."""
    return {"title": title, "url": url, "targetBlank": False}


def value_names(names: Mapping[int, tuple[str, str]]) -> list[Json]:
    """Return mappings of values to a word and a colour."""
    options = {
        str(value): {"text": text, "color": colour, "index": index}
        for index, (value, (text, colour)) in enumerate(names.items())
    }
    return [{"type": "value", "options": options}]


def number(
    title: str,
    about: str,
    query: Query,
    *,
    unit: str = "none",
    empty: str,
    yellow: float | None = None,
    red: float | None = None,
    names: Mapping[int, tuple[str, str]] | None = None,
    links: Sequence[Json] = (),
) -> Panel:
    """Return one big number; `empty` is what stands there when nothing answers."""
    defaults: Json = {
        "unit": unit,
        "noValue": empty,
        "thresholds": thresholds(warn(yellow, red)),
        "mappings": value_names(names) if names else [],
        "links": list(links),
    }
    options = {
        "reduceOptions": {"calcs": ["lastNotNull"], "fields": "", "values": False},
        "colorMode": "value" if yellow is None and red is None and not names else "background",
        "graphMode": "none",
        "textMode": "auto",
    }
    field = {"defaults": defaults, "overrides": []}
    return made("stat", title, about, [query], fieldConfig=field, options=options)


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
    links: Sequence[Json] = (),
    special: Mapping[str, Sequence[Json]] | None = None,
) -> Panel:
    """Return values over time, a curve for each series.

    Args:
        red: a limit, drawn as a line.
        special: other links for the series of a query, by its refId.
    """
    custom: Json = {"lineWidth": 1, "fillOpacity": 20 if stacked else 5, "showPoints": "never"}
    custom |= {"stacking": {"mode": "normal" if stacked else "none", "group": "A"}}
    custom |= {"thresholdsStyle": {"mode": "line" if red is not None else "off"}}
    defaults: Json = {"unit": unit, "noValue": empty, "custom": custom, "links": list(links)}
    defaults |= {} if least is None else {"min": least}
    defaults |= {} if most is None else {"max": most}
    defaults |= {"decimals": 0} if unit == "none" else {}  # things are counted
    if red is not None:
        defaults["thresholds"] = thresholds(warn(None, red))
    options = {
        "legend": {
            "displayMode": "table",
            "placement": "right",
            "showLegend": True,
            "calcs": ["lastNotNull", "max"],
        },
        "tooltip": {"mode": "multi", "sort": "desc"},
    }
    overrides = [
        override("byFrameRefID", ref, {"links": list(own)}) for ref, own in (special or {}).items()
    ]
    field = {"defaults": defaults, "overrides": overrides}
    return made("timeseries", title, about, queries, fieldConfig=field, options=options)


def states(
    title: str,
    about: str,
    queries: Sequence[Query],
    *,
    names: Mapping[int, tuple[str, str]],
    empty: str,
    links: Sequence[Json] = (),
) -> Panel:
    """Return bars over time, one for each series, coloured by what its value means."""
    defaults = {
        "noValue": empty,
        "mappings": value_names(names),
        "links": list(links),
        "custom": {"fillOpacity": 75, "lineWidth": 0},
    }
    options = {
        "mergeValues": True,
        "showValue": "never",
        "alignValue": "left",
        "rowHeight": 0.8,
        "legend": {"displayMode": "list", "placement": "bottom", "showLegend": True, "calcs": []},
        "tooltip": {"mode": "single", "sort": "none"},
    }
    field = {"defaults": defaults, "overrides": []}
    return made("state-timeline", title, about, queries, fieldConfig=field, options=options)


def override(matcher: str, name: str, properties: Mapping[str, Any]) -> Json:
    """Return what is special about some fields: a column, the series of a query."""
    return {
        "matcher": {"id": matcher, "options": name},
        "properties": [{"id": key, "value": value} for key, value in properties.items()],
    }


def table(
    title: str,
    about: str,
    queries: Sequence[Query],
    *,
    columns: Mapping[str, str],
    empty: str,
    special: Mapping[str, Mapping[str, Any]] | None = None,
    sort: str | None = None,
) -> Panel:
    """Return a table of the latest values, a row for each set of labels.

    Args:
        columns: labels, and `Value #A` of the first query, by their titles, in the order wanted;
            what is not named is not shown.
        special: properties (unit, mappings, links) by a column's title.
        sort: the title of the column that the rows are sorted by, the greatest first.
    """
    order = named(columns, single=len(queries) == 1, source=queries[0].source)
    organize = {
        "includeByName": dict.fromkeys(order, True),
        "indexByName": {name: index for index, name in enumerate(order)},
        "renameByName": order,
    }
    overrides = [override("byName", name, own) for name, own in (special or {}).items()]
    return made(
        "table",
        title,
        about,
        queries,
        fieldConfig={"defaults": {"noValue": empty}, "overrides": overrides},
        options={
            "showHeader": True,
            "sortBy": [{"displayName": sort, "desc": True}] if sort else [],
        },
        transformations=[*joined(queries), {"id": "organize", "options": organize}],
    )


def named(columns: Mapping[str, str], *, single: bool, source: str) -> dict[str, str]:
    """Return the columns as they come: a single query's value is `Value`, Loki's either."""
    names = {}
    for name, title in columns.items():
        both = [name, "Value"] if source == "logs" and name == "Value #A" else [name]
        for one in ["Value"] if single and source == "metrics" and name == "Value #A" else both:
            names[one] = title
    return names


def joined(queries: Sequence[Query]) -> list[Json]:
    """Return the steps from answers to rows: Loki gives a frame for each series."""
    labels = {"id": "labelsToFields", "options": {"mode": "columns"}}
    merge: Json = {"id": "merge", "options": {}}
    if queries[0].source == "logs":
        return [labels, merge]
    return [merge] if len(queries) > 1 else []


def lines(title: str, about: str, query: Query) -> Panel:
    """Return the log lines themselves, the newest first."""
    options = {
        "showTime": True,
        "showLabels": False,
        "showCommonLabels": False,
        "wrapLogMessage": True,
        "prettifyLogMessage": False,
        "enableLogDetails": True,
        "dedupStrategy": "none",
        "sortOrder": "Descending",
    }
    return made("logs", title, about, [query], options=options)

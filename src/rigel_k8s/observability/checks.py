"""What is wrong with the options of observability beyond the form of single values; pure."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rigel_k8s.observability.options import (
    Component,
    Observability,
    Part,
    RosMetrics,
)
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem

#: Seconds: Loki's index is of days, and what is deleted of it too.
DAY = 86_400
URL = re.compile(r"https?://[A-Za-z0-9._\[\]:-]+(/\S*)?")
TARGET = re.compile(r"[A-Za-z0-9._\[\]-]+:\d{1,5}")


def check(options: Observability) -> Iterator[Problem]:
    """Yield what is wrong, and what works otherwise than it looks."""
    yield from check_helm(options)
    yield from check_password(options)
    yield from check_spans(options)
    yield from check_collector(options)
    yield from check_existing(options)
    yield from check_ros_metrics(options)
    for index, target in enumerate(options.prometheus.alertmanagers):
        if not TARGET.fullmatch(target) and not has_template(target):
            message = f'"{target}" is no HOST:PORT, alertmanager.monitoring:9093 say'
            yield Problem(("prometheus", "alertmanagers", index), message, "bad-address")


def check_helm(options: Observability) -> Iterator[Problem]:
    """Yield Helm's words: no chart is installed."""
    for name in ("grafana", "prometheus", "loki"):
        part: Component = getattr(options, name)
        given = [key for key in ("release", "chart", "values") if getattr(part, key)]
        for key in given:
            message = f"{key} is of a Helm chart, and none is installed: it is not used"
            yield Problem((name, key), message, "not-used", severity="warning", at_key=True)


def check_password(options: Observability) -> Iterator[Problem]:
    """Yield a password that everybody reads who reads the Rigelfile."""
    if options.grafana.admin_password:
        message = (
            "a password in clear text: leave it out, and a random one is made and kept in the"
            " Secret grafana-admin"
        )
        path = ("grafana", "admin_password")
        yield Problem(path, message, "clear-password", severity="warning", at_key=True)


def check_spans(options: Observability) -> Iterator[Problem]:
    """Yield spans that Loki or Prometheus would refuse."""
    kept = options.loki.retention
    if kept is not None and 0 < kept.seconds < DAY:
        message = f'"{kept}" is too short: Loki deletes by days, say 24h or more (0: never)'
        yield Problem(("loki", "retention"), message, "bad-duration")
    for key in ("retention", "scrape_interval", "evaluation_interval"):
        span = getattr(options.prometheus, key)
        if span is not None and span.seconds <= 0:
            message = f'"{span}" is no span of time; leave it out for the default'
            yield Problem(("prometheus", key), message, "bad-duration")


def check_collector(options: Observability) -> Iterator[Problem]:
    """Yield a collector that nobody maintains, and one that is configured and not used."""
    used = options.collector or "promtail"
    other = "alloy" if used == "promtail" else "promtail"
    said: Part = getattr(options, other)
    if said not in (Part(), Part(enabled=False)):
        message = f"the collector is {used}: this has no effect; say collector: {other}"
        yield Problem((other,), message, "not-used", severity="warning", at_key=True)
    if options.enabled and options.collector is None and reads_lines(options):
        message = (
            "Promtail reads the log lines, and its upkeep ended in March 2026: `collector: alloy`"
            " takes its successor, which gives the same labels; `collector: promtail` keeps it"
        )
        yield Problem((), message, "end-of-life", severity="warning", at_key=True)


def reads_lines(options: Observability) -> bool:
    """Return whether log lines are collected, as far as the options alone tell."""
    sent = options.loki.enabled or (options.existing is not None and options.existing.loki)
    return bool(sent) and options.promtail.enabled


def check_existing(options: Observability) -> Iterator[Problem]:
    """Yield what is there already and asked for a second time, and what cannot be reached."""
    existing = options.existing
    if existing is None:
        return
    loki = existing.loki
    prometheus = existing.prometheus
    if loki is not None and not URL.fullmatch(loki.url) and not has_template(loki.url):
        message = f'"{loki.url}" is no URL, http://loki.logging:3100 say'
        yield Problem(("existing", "loki", "url"), message, "bad-url")
    url = prometheus.url if prometheus else None
    if url is not None and not URL.fullmatch(url) and not has_template(url):
        message = f'"{url}" is no URL, http://prometheus.monitoring:9090 say'
        yield Problem(("existing", "prometheus", "url"), message, "bad-url")
    ours = options.grafana.enabled and not existing.grafana
    if prometheus and ours and url is None:
        message = (
            "a Grafana of this stack must be told where that Prometheus answers: give its `url`,"
            " or say grafana: {enabled: false} or existing: {grafana: true}"
        )
        yield Problem(("existing", "prometheus"), message, "missing-url", at_key=True)
    for name, there in (("loki", loki), ("prometheus", prometheus), ("grafana", existing.grafana)):
        if there and has_data(getattr(options, name)):
            message = f"the {name} that is there already is used: this has no effect"
            yield Problem((name,), message, "not-used", severity="warning", at_key=True)
    if existing.grafana and not options.grafana.default_dashboards:
        message = "default_dashboards: false leaves that Grafana's sidecar nothing to load"
        yield Problem(("existing", "grafana"), message, "not-used", severity="warning", at_key=True)


def has_data(part: Component) -> bool:
    """Return whether a part was told how it shall keep its data or be reached."""
    persistence = getattr(part, "persistence", None)
    told = persistence is not None and persistence != type(persistence)()
    return told or bool(getattr(part, "retention", None)) or part.service_type is not None


def check_ros_metrics(options: Observability) -> Iterator[Problem]:
    """Yield topics that are named twice, and an exporter without a stack."""
    said = options.ros_metrics
    if not isinstance(said, RosMetrics):
        return
    seen: set[str] = set()
    for index, topic in enumerate(said.topics):
        name = "/" + str(topic).strip("/")
        if name in seen:
            path = ("ros_metrics", "topics", index)
            yield Problem(path, f"{name} is named already", "name-taken")
        seen.add(name)

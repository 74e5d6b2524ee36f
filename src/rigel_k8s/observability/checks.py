"""Checks of the options of observability beyond the form of single values; pure."""

from __future__ import annotations

import re
from collections.abc import Iterator

import attrs

from rigel_k8s.objects.resources import check_resources, explain_few_bytes
from rigel_k8s.observability.options import (
    DEFAULT_COLLECTOR,
    ChartProgram,
    Observability,
    Program,
    StackProgram,
    find_collector,
)
from rigel_k8s.problems import Problem

#: The paths of requests, which people paste.
REQUEST = re.compile(r"/(loki/api|otlp|api/v\d|graph|ready|metrics)\b.*")
#: Seconds: Loki's index has a part for each day, and Loki deletes whole parts.
DAY = 86_400


def check(options: Observability) -> Iterator[Problem]:
    """Yield errors, and warnings of options without the expected effect."""
    yield from check_helm(options)
    yield from check_password(options)
    yield from check_spans(options)
    yield from check_collector(options)
    yield from check_existing(options)
    yield from check_address(options)
    for name, part in attrs.asdict(options, recurse=False).items():
        if isinstance(part, Program):
            yield from (one.under((name,)) for one in check_resources(part.resources))
        kept = getattr(part, "persistence", None)
        if kept and (problem := explain_few_bytes(kept.size)):
            yield Problem((name, "persistence", "size"), problem, "bad-quantity")


def check_helm(options: Observability) -> Iterator[Problem]:
    """Yield options of Helm, which have no effect: no chart is installed."""
    for name in ("grafana", "prometheus", "loki"):
        part: ChartProgram = getattr(options, name)
        given = [key for key in ("release", "chart", "values") if getattr(part, key)]
        for key in given:
            message = f"`{key}` is an option of a Helm chart and is not used: no chart is installed"
            yield Problem((name, key), message, "not-used", severity="warning", at_key=True)


def check_password(options: Observability) -> Iterator[Problem]:
    """Yield a password that every reader of the Rigelfile can read."""
    if options.grafana.admin_password:
        message = (
            "a password in clear text: remove it, and a random one is created in the Secret"
            " grafana-admin"
        )
        path = ("grafana", "admin_password")
        yield Problem(path, message, "clear-password", severity="warning", at_key=True)


def check_spans(options: Observability) -> Iterator[Problem]:
    """Yield spans that Loki or Prometheus would refuse."""
    kept = options.loki.retention
    if kept is not None and 0 < kept.seconds < DAY:
        message = f'"{kept}" is too short: Loki deletes by days, use 24h or more (0: never)'
        yield Problem(("loki", "retention"), message, "bad-duration")
    for key in ("retention", "scrape_interval", "evaluation_interval"):
        span = getattr(options.prometheus, key)
        if span is not None and span.seconds <= 0:
            message = f'invalid duration "{span}": use more than 0, or remove it for the default'
            yield Problem(("prometheus", key), message, "bad-duration")


def check_collector(options: Observability) -> Iterator[Problem]:
    """Yield collectors that are configured but not used, and a Loki that needs a setting."""
    used = options.collector or DEFAULT_COLLECTOR
    untouched = (StackProgram(), StackProgram(enabled=False))
    for other in ("otel-collector", "promtail"):
        if other != used and find_collector(options, other) not in untouched:
            message = f"the collector is {used}, so this has no effect; set `collector: {other}`"
            path = (other.replace("-", "_"),)
            yield Problem(path, message, "not-used", severity="warning", at_key=True)
    if options.existing and options.existing.loki and options.collector is None:
        message = (
            "the OpenTelemetry Collector sends labels as OTLP attributes, so this Loki needs an"
            " `otlp_config` that makes labels of them; set `collector: otel-collector` if it has"
            " one, or `collector: promtail`, which needs none"
        )
        yield Problem(("existing", "loki"), message, "otlp-labels", severity="warning", at_key=True)


def check_address(options: Observability) -> Iterator[Problem]:
    """Yield the URL of a request in place of a server's own: rigel adds the path itself."""
    for name in ("loki", "prometheus"):
        part = options.existing and getattr(options.existing, name)
        url = str(getattr(part, "url", None) or "")
        if (base := REQUEST.sub("", url)) != url:
            message = f"it is the server's own URL, without the path of a request: write {base}"
            yield Problem(("existing", name, "url"), message, "bad-url")


def check_existing(options: Observability) -> Iterator[Problem]:
    """Yield existing parts that are configured again, and those without an address."""
    existing = options.existing
    if existing is None:
        return
    loki = existing.loki
    prometheus = existing.prometheus
    ours = options.grafana.enabled and not existing.grafana
    if prometheus and ours and prometheus.url is None:
        message = (
            "this stack's Grafana needs the address of that Prometheus: set its `url`, or"
            " `grafana: {enabled: false}` or `existing: {grafana: true}`"
        )
        yield Problem(("existing", "prometheus"), message, "missing-url", at_key=True)
    for name, there in (("loki", loki), ("prometheus", prometheus), ("grafana", existing.grafana)):
        if there and has_data(getattr(options, name)):
            message = f"the existing {name} is used, so this has no effect"
            yield Problem((name,), message, "not-used", severity="warning", at_key=True)


def has_data(part: ChartProgram) -> bool:
    """Return whether options say how a part keeps its data or how it is reached."""
    persistence = getattr(part, "persistence", None)
    given = persistence is not None and persistence != type(persistence)()
    return given or bool(getattr(part, "retention", None)) or part.service_type is not None

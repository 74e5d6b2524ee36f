"""What the options of observability may not say, and what works otherwise than it looks."""

from __future__ import annotations

import pytest

from rigel_k8s.observability.checks import check

from .shapes import options

WRONG = [
    ("bad-duration", "loki.retention", "{loki: {retention: 12h}}"),
    ("bad-duration", "prometheus.retention", "{prometheus: {retention: 0s}}"),
    ("bad-duration", "prometheus.scrape_interval", "{prometheus: {scrape_interval: 0s}}"),
    ("bad-quantity", "loki.resources.limits.memory", "{loki: {resources: {limits: {memory: 9}}}}"),
    ("missing-url", "existing.prometheus", "{existing: {prometheus: true}}"),
]
WARNINGS = [
    ("not-used", "loki.chart", "{loki: {chart: grafana/loki}}"),
    ("not-used", "grafana.values", "{grafana: {values: {a: 1}}}"),
    ("clear-password", "grafana.admin_password", "{grafana: {admin_password: x}}"),
    ("not-used", "promtail", "{promtail: {image: a}}"),
    ("not-used", "otel_collector", "{collector: promtail, otel_collector: {image: a}}"),
    ("otlp-labels", "existing.loki", "{existing: {loki: {url: 'http://loki.logging:3100'}}}"),
    (
        "not-used",
        "loki",
        "{collector: otel-collector, loki: {retention: 7d}, existing: {loki: {url: 'http://l:1'}}}",
    ),
]
RIGHT = [
    "{enabled: true}",
    "{collector: promtail, promtail: {image: a}}",
    "{collector: promtail, existing: {loki: {url: 'http://loki.logging:3100'}}}",
    "{}",
    "{loki: {retention: 1d}}",
    "{loki: {retention: 0}}",
    "{existing: {prometheus: true, grafana: true}}",
    "{existing: {prometheus: true}, grafana: {enabled: false}}",
    "{existing: {prometheus: {url: 'http://prometheus.monitoring:9090'}}}",
    "{prometheus: {alertmanagers: ['alertmanager.ops:9093']}}",
]


def told(text: str, severity: str) -> set[tuple[str, str]]:
    """Return (kind, place) of all problems of a severity."""
    found = [p for p in check(options(text)) if p.severity == severity]
    assert all(problem.message for problem in found)
    return {(p.kind, ".".join(map(str, p.path))) for p in found}


@pytest.mark.parametrize(("kind", "place", "text"), WRONG)
def test_what_a_program_would_refuse_is_told_at_its_place(kind: str, place: str, text: str) -> None:
    """One mistake is one problem."""
    assert told(text, "error") == {(kind, place)}


@pytest.mark.parametrize(("kind", "place", "text"), WARNINGS)
def test_what_has_no_effect_is_a_warning(kind: str, place: str, text: str) -> None:
    """A warning stops nothing."""
    assert told(text, "warning") == {(kind, place)}
    assert told(text, "error") == set()


@pytest.mark.parametrize("text", RIGHT)
def test_what_is_right_is_told_nothing_of(text: str) -> None:
    """No word about what works."""
    assert told(text, "error") | told(text, "warning") == set()

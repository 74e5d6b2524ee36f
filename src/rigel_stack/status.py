"""observe status: whether the stack runs, answers and receives data; and which alerts fire."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import connect
from rigel_k8s.observability.names import GRAFANA, LOKI, PROMETHEUS, RELEASE
from rigel_k8s.observability.reading.stack import (
    InstalledStack,
    NoStack,
    StackService,
    explain,
    find_stack,
)
from rigel_k8s.release import status as states
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings

#: Lines of each application, lately.
HEARD = 'sum by (application) (count_over_time({application=~".+"}[5m]))'


@attrs.frozen
class Answer:
    """Whether a part answers, and what it receives, or why it does not answer.

    Attributes:
        ok: None if it cannot be reached, since it is not part of the stack.
    """

    name: str
    ok: bool | None
    said: str


@attrs.frozen
class Alert:
    """An alert that fires: its name, labels, start and summary."""

    name: str
    labels: Mapping[str, str]
    since: str
    summary: str


@attrs.frozen
class ObserveStatus:
    """The state of the stack, and the alerts about what it watches."""

    release: states.ReleaseStatus
    answers: tuple[Answer, ...]
    alerts: tuple[Alert, ...]

    @property
    def ok(self) -> bool:
        """Whether all parts run and answer, except those without which the stack is good."""
        workloads = self.release.workloads
        spared = {workload.name for workload in workloads if workload.ok and not workload.done}
        return all(w.ok for w in workloads) and all(
            a.ok is not False or a.name in spared for a in self.answers
        )


def status(settings: Settings) -> ObserveStatus:
    """Return the state of the stack; raises as find_stack."""
    with connect(settings) as cluster:
        stack = find_stack(cluster, settings.namespace)
        release = states.status(cluster, ReleaseId(stack.namespace, RELEASE))
        names = [name for name in LOOKS if name in {*stack.services, *stack.existing}]
        answers = cluster.parallel(lambda name: answer(stack, name), names)
        return ObserveStatus(release, tuple(answers), alerts(stack))


def answer(stack: InstalledStack, name: str) -> Answer:
    """Return whether a part answers, and what it receives."""
    there = stack.existing.get(name, {}) if name not in stack.services else {}
    of = f" ({there['url']})" if there else ""
    try:
        found = LOOKS[name](stack.part(name))
    except NoStack as error:
        return Answer(name, ok=None, said=error.message)
    except ClusterError as error:
        return Answer(name, ok=False, said=explain(name.capitalize(), error) + of)
    return Answer(name, found.ok, found.said + of)


def grafana(part: StackService) -> Answer:
    """Ask Grafana for its health."""
    health = json.loads(part.ask("api/health"))
    ok = health.get("database") == "ok"
    return Answer(part.name, ok, f"database {health.get('database')}")


def prometheus(part: StackService) -> Answer:
    """Ask Prometheus which of its targets it reaches; unreached targets are not its error."""
    targets = data(part, "api/v1/targets", state="active")["activeTargets"]
    down = [name_of(one["labels"]) for one in targets if one["health"] == "down"]
    reached = f"{len(targets) - len(down)} of {len(targets)} targets"
    missed = f"; not {', '.join(sorted(down))}" if down else ""
    return Answer(part.name, ok=True, said=reached + missed)


def name_of(labels: Mapping[str, str]) -> str:
    """Return a target's name for people."""
    if "pod" in labels:
        return f"{labels.get('namespace', '')}/{labels['pod']}"
    return f"{labels.get('job', '')} of {labels.get('node') or labels.get('instance', '')}"


def loki(part: StackService) -> Answer:
    """Ask Loki whose lines it received lately."""
    found = data(part, "loki/api/v1/query", query=HEARD)["result"]
    lines = {one["metric"].get("application", ""): int(one["value"][1]) for one in found}
    heard = ", ".join(f"{name} {count}" for name, count in sorted(lines.items()))
    return Answer(part.name, ok=True, said=f"lines in 5 minutes: {heard or 'none'}")


LOOKS: Mapping[str, Callable[[StackService], Answer]] = {
    GRAFANA: grafana,
    PROMETHEUS: prometheus,
    LOKI: loki,
}


def alerts(stack: InstalledStack) -> tuple[Alert, ...]:
    """Return the alerts that fire; none if Prometheus does not answer, which is reported anyway."""
    try:
        found = data(stack.part(PROMETHEUS), "api/v1/alerts")["alerts"]
    except (ClusterError, NoStack):
        return ()
    firing = []
    for one in found:
        if one["state"] == "firing":
            labels, notes = dict(one["labels"]), one.get("annotations", {})
            summary = notes.get("summary") or notes.get("description") or ""
            firing.append(Alert(labels.pop("alertname"), labels, one["activeAt"], summary))
    return tuple(firing)


def data(part: StackService, path: str, **query: str) -> Any:
    """Return the data of an answer in the form that Prometheus and Loki share."""
    return json.loads(part.ask(path, query))["data"]

"""Prometheus' API: what a query says now. It knows no pods and no releases."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping

import attrs


@attrs.frozen
class Sample:
    """One value, and the labels of its series."""

    labels: Mapping[str, str]
    value: float


class PrometheusClient:
    """Asks a Prometheus."""

    def __init__(self, ask: Callable[[str, Mapping[str, object]], bytes]) -> None:
        self._ask = ask

    def query(self, expression: str) -> list[Sample]:
        """Return what an expression that gives a vector says now, without what is no number."""
        answer = json.loads(self._ask("api/v1/query", {"query": expression}))
        found = answer["data"]["result"]
        samples = [Sample(one["metric"], float(one["value"][1])) for one in found]
        return [sample for sample in samples if math.isfinite(sample.value)]


def matchers(**labels: str) -> str:
    """Return the matchers between a selector's braces."""
    return ",".join(f"{name}={json.dumps(value)}" for name, value in labels.items())

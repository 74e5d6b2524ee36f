"""Prometheus' API: the current result of a query; independent of pods and releases."""

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
    """Queries a Prometheus."""

    def __init__(self, ask: Callable[[str, Mapping[str, object]], bytes]) -> None:
        self._ask = ask

    def query(self, expression: str) -> list[Sample]:
        """Return the current vector of an expression, without values that are not numbers."""
        answer = json.loads(self._ask("api/v1/query", {"query": expression}))
        found = answer["data"]["result"]
        samples = [Sample(one["metric"], float(one["value"][1])) for one in found]
        return [sample for sample in samples if math.isfinite(sample.value)]


def matchers(**labels: str) -> str:
    """Return the matchers between a selector's braces."""
    return ",".join(f"{name}={json.dumps(value)}" for name, value in labels.items())

"""The preflight as a deploy uses it: its warnings are reported, its errors raised."""

from __future__ import annotations

from typing import Any

from rigel_k8s.network.options import Network
from rigel_k8s.report import Reporter
from rigel_multus.preflight.examine import inspect


def check(objects: Any, network: Network | None, cluster: Any, report: Reporter) -> None:
    error, warnings = inspect(objects, network, cluster)
    for warning in warnings:
        report.warn(warning)
    if error:
        raise error

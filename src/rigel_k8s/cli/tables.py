"""Results as columns of text."""

from __future__ import annotations

from collections.abc import Sequence

import click

from rigel_k8s.deploy.status import ReleaseStatus

__all__ = ["status_table", "table"]


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return rows below heads, in columns as wide as their widest cell."""
    everything = [list(heads), *[list(row) for row in rows]]
    widths = [max(len(row[i]) for row in everything) for i in range(len(heads))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)) for r in everything]
    return "\n".join(line.rstrip() for line in lines)


def status_table(found: ReleaseStatus) -> str:
    """Return a release's workloads and pods, and below them why something is not ready."""
    rows, reasons = [], []
    for workload in found.workloads:
        ready = f"{workload.ready}/{workload.desired}"
        pods = workload.pods or [None]
        for pod in pods:
            cells = (
                (pod.name, pod.node, str(pod.restarts), pod.age) if pod else ("-", "-", "-", "-")
            )
            rows.append([workload.name, ready, *cells])
            if pod and pod.message:
                reasons.append(f"{pod.name}: {pod.message}")
        if workload.message:
            reasons.append(f"{workload.name}: {workload.message}")
    heads = ["NODE", "READY", "POD", "ON", "RESTARTS", "AGE"]
    text = table(heads, rows) if rows else "nothing runs"
    told = "\n".join(click.style(reason, fg="yellow") for reason in reasons)
    return f"{text}\n\n{told}" if told else text

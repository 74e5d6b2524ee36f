"""`rigel top`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import attrs
import click

from rigel_k8s.cli.words import (
    complete_node,
    json_option,
    namespace_option,
    print_json,
    release_option,
    settings,
)

if TYPE_CHECKING:
    from rigel_k8s.commands.top import Top, Topics, TopicUsage, UsageRow

T = TypeVar("T")
KIB = 1024.0
HEADS = ["NODE", "ROS NAME", "UP", "CPU", "MEMORY", "OUT", "IN", "RESTARTS", "POD", "ON"]


@click.command()
@click.argument("nodes", nargs=-1, metavar="[NODE]...", shell_complete=complete_node)
@click.option(
    "--topics", is_flag=True, help="Show topics instead: rates, ages, publishers and subscribers."
)
@json_option
@release_option
@namespace_option
@click.pass_context
def top(
    ctx: click.Context,
    /,
    nodes: tuple[str, ...],
    topics: bool,  # noqa: FBT001 - click passes it by name
    output: str,
    job: str | None,
) -> None:
    """Show what ROS nodes use and do; all nodes if you name none.

    CPU and memory come from the metrics-server, else from the kubelets. With the observability
    stack, the ROS exporter of an application adds UP, and for ROS 1 OUT and IN in messages per
    second.
    """
    from rigel_k8s.commands import top as actions

    if topics:
        show_topics(actions.topics(settings(ctx), nodes, job), output)
    else:
        show(actions.top(settings(ctx), nodes, job), output)


def show(found: Top, output: str) -> None:
    """Print what nodes use."""
    from rigel_k8s.cli.tables import table

    if output == "json":
        nodes = [attrs.asdict(row) for row in found.rows]
        print_json({**attrs.asdict(found.release), "source": found.source, "nodes": nodes})
        return
    hidden: set[str] = set()  # what only a ROS exporter knows, some of it only in ROS 1
    if all(row.up is None for row in found.rows):
        hidden = {"UP"}
    if all(row.published is None and row.received is None for row in found.rows):
        hidden |= {"OUT", "IN"}
    shown = [i for i, head in enumerate(HEADS) if head not in hidden]
    heads, *rows = ([line[i] for i in shown] for line in (HEADS, *map(cells, found.rows)))
    click.echo(table(heads, rows))


def cells(row: UsageRow) -> list[str]:
    return [
        row.workload,
        row.ros_name or "-",
        format_cell(row.up, lambda up: "yes" if up else "NO"),
        format_cell(row.cpu, lambda cores: f"{cores * 1000:.0f}m"),
        format_cell(row.memory, lambda size: f"{size / KIB / KIB:.0f}Mi"),
        format_cell(row.published, rate),
        format_cell(row.received, rate),
        str(row.restarts),
        row.pod,
        row.node or "-",
    ]


def show_topics(found: Topics, output: str) -> None:
    from rigel_k8s.cli.tables import table

    if output == "json":
        rows = [attrs.asdict(row) for row in found.rows]
        print_json({**attrs.asdict(found.release), "topics": rows})
        return
    heads = ["TOPIC", "TYPE", "FROM", "TO", "RATE", "BANDWIDTH", "LAST", "DELAY"]
    click.echo(table(heads, [topic_cells(row) for row in found.rows]))
    if not any(row.heard for row in found.rows):
        click.echo("LAST and DELAY: only of topics in `ros_metrics: {topics: [...]}`", err=True)


def topic_cells(row: TopicUsage) -> list[str]:
    return [
        row.name,
        row.type or "-",
        str(row.publishers),
        str(row.subscribers),
        format_cell(row.rate, lambda value: f"{rate(value)}/s"),
        format_cell(row.bandwidth, lambda value: f"{size_of(value)}/s"),
        format_cell(row.age, lambda value: f"{max(0.0, value):.1f}s ago"),
        format_cell(row.delay, lambda value: f"{value * 1000:.1f}ms"),
    ]


def format_cell(value: T | None, write: Callable[[T], str]) -> str:
    """Return a cell; - if unknown."""
    return "-" if value is None else write(value)


def rate(value: float) -> str:
    """Return a number per second: 0.25, 9.8, 120."""
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 1 else f"{value:.2g}"


def size_of(value: float) -> str:
    """Return bytes as text with a unit."""
    for unit in ("B", "Ki", "Mi"):
        if value < KIB:
            return f"{value:.0f}{unit}" if unit == "B" else f"{value:.1f}{unit}"
        value /= KIB
    return f"{value:.1f}Gi"

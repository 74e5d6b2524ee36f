"""`rigel topic`: list, echo, hz."""

from __future__ import annotations

import json
import math
import sys
import time
from typing import TYPE_CHECKING, Any

import click

from rigel_k8s.cli.words import (
    Group,
    complete_node,
    json_option,
    namespace_option,
    print_json,
    release_argument,
    release_option,
    settings,
)
from rigel_k8s.objects.text import plural

if TYPE_CHECKING:
    from rigel_graph.hz import Beat
    from rigel_graph.types import GraphTopic

#: What scripts get of a topic (docs/watching.md).
SHOWN = ("name", "type", "rate", "publishers", "subscribers")
REPORT = 1.0  # seconds between two reports of messages that were left out


@click.group(cls=Group)
def topic() -> None:
    """List ROS topics, print their messages, measure their rates.

    No ROS is needed here: messages are read in a running pod, with the ROS of its image.
    """


@topic.command("list")
@release_argument
@namespace_option
@json_option
@click.option("--all", "everything", is_flag=True, help="Also list topics that every node has.")
@click.pass_context
def list_(
    ctx: click.Context,
    /,
    job: str | None,
    output: str,
    everything: bool,  # noqa: FBT001 - click passes it by name
) -> None:
    """List the topics of a release."""
    from rigel_graph.commands.graph import graph
    from rigel_k8s.cli.tables import table

    topics = [t for t in graph(settings(ctx), job).graph.topics if everything or t.is_public]
    if output == "json":
        print_json([{key: getattr(one, key) for key in SHOWN} for one in topics])
        return
    heads = ["TOPIC", "TYPE", "RATE", "FROM", "TO"]
    click.echo(table(heads, [cells(one) for one in topics]))


def cells(one: GraphTopic) -> list[str]:
    """Return a topic's row."""
    from rigel_k8s.cli.top import format_cell, rate

    counts = str(len(one.publishers)), str(len(one.subscribers))
    return [
        one.name,
        one.type or "-",
        format_cell(one.rate, lambda value: f"{rate(value)}/s"),
        *counts,
    ]


@topic.command()
@click.argument("name", metavar="TOPIC")
@click.option(
    "--node",
    metavar="NODE",
    help="Subscribe in this node's pod [default: a publisher's].",
    shell_complete=complete_node,
)
@click.option(
    "-n",
    "--count",
    metavar="COUNT",
    type=click.IntRange(min=1),
    help="End after this many messages.",
)
@click.option("--once", is_flag=True, help="End after one message.")
@click.option("--field", metavar="A.B", help="Print this field of each message.")
@click.option("--full-length", is_flag=True, help="Print long arrays and texts in full.")
@click.option(
    "-o",
    "--output",
    type=click.Choice(["yaml", "json"]),
    default="yaml",
    show_default=True,
    help="Print in this format; json: a line for each message.",
)
@release_option
@click.pass_context
def echo(
    ctx: click.Context,
    /,
    name: str,
    node: str | None,
    count: int | None,
    once: bool,  # noqa: FBT001 - click passes them by name
    field: str | None,
    full_length: bool,  # noqa: FBT001
    output: str,
    job: str | None,
) -> None:
    """Print the messages of a topic as they come, until Ctrl-C.

    Of arrays and texts the first 128 elements are printed. If the terminal or the network is too
    slow, messages are left out and counted.
    """
    from rigel_graph.commands import topics

    messages = topics.echo(
        settings(ctx),
        name,
        node=node,
        count=1 if once else count,
        field=field or "",
        most=None if full_length else topics.SHORT,
        job=job,
    )
    dropped, shortened, reported = 0, False, 0.0
    for one in messages:
        if one["dropped"] > dropped and time.monotonic() > reported + REPORT:
            reported = time.monotonic()
            missing = plural(one["dropped"] - dropped, "message")
            click.echo(f"{missing} left out: the reader is too slow", err=True)
            dropped = one["dropped"]
        click.echo(write(one["message"], output), nl=False)
        sys.stdout.flush()
        if one["shortened"] and not shortened:
            shortened = True
            click.echo("long arrays and texts are shortened; --full-length prints all", err=True)


def write(message: Any, output: str) -> str:
    """Return a message as a document of YAML, or a line of JSON."""
    if output == "json":
        return json.dumps(strip_numbers(message), ensure_ascii=False) + "\n"
    from rigel_k8s.yaml_text import write_value

    return f"{write_value(message)}\n---\n"


def strip_numbers(value: Any) -> Any:
    """Return a value with null for what JSON cannot have: infinite, and not a number."""
    if isinstance(value, dict):
        return {key: strip_numbers(one) for key, one in value.items()}
    if isinstance(value, list):
        return [strip_numbers(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@topic.command()
@click.argument("name", metavar="TOPIC")
@release_option
@namespace_option
@click.pass_context
def hz(ctx: click.Context, /, name: str, job: str | None) -> None:
    """Print once a second how often a topic is published, until Ctrl-C.

    The publishers count it themselves, so nothing subscribes. GAP is the longest time between two
    messages in the last minute.
    """
    from rigel_graph.commands import topics

    for beat in topics.hz_of(settings(ctx), name, job):
        click.echo(beat if isinstance(beat, str) else beat_text(beat))
        sys.stdout.flush()


def beat_text(beat: Beat) -> str:
    """Return a second of a topic as a line."""
    from rigel_k8s.cli.top import rate

    parts = [f"{rate(beat.rate)}/s"]
    if beat.gap is not None:
        parts.append(f"longest gap {beat.gap:.3f} s")
    if beat.subscribers is not None:
        parts.append(plural(beat.subscribers, "subscriber"))
    if beat.lost is not None:
        parts.append(f"{rate(beat.lost) if beat.lost else 0}/s lost")
    return ", ".join(parts)

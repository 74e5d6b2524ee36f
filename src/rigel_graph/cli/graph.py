"""`rigel graph`: the ROS graph as text, as JSON, as a picture, or as a layout for Foxglove."""

from __future__ import annotations

import json
import sys
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rigel_k8s.cli.width import make_printable
from rigel_k8s.cli.words import namespace_option, release_argument, settings

if TYPE_CHECKING:
    from rigel_graph.commands.graph import LiveGraph
    from rigel_graph.drawing import Picture

FORMS = ("text", "json", "dot", "foxglove")
#: What is not in the JSON of a topic: losses are among the problems; no script needs the rest.
OMITTED = ("losses", "exists", "notes")
#: Pictures, which Graphviz draws.
PICTURES = ("svg", "png", "pdf")
#: The format by a file's suffix.
ENDINGS = {".txt": "text", ".json": "json", ".dot": "dot", ".gv": "dot"}
ENDINGS |= {f".{form}": form for form in PICTURES}


@click.command()
@release_argument
@namespace_option
@click.option(
    "-o",
    "--output",
    type=click.Choice(FORMS),
    help="Print in this format; foxglove is a layout that it and Lichtblick import [default: text,"
    " or by the suffix of the file after --to].",
)
@click.option(
    "--to",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write to this file; Graphviz draws those that end in .svg, .png or .pdf.",
)
@click.option(
    "--all",
    "everything",
    is_flag=True,
    help="Also show /rosout and other topics that every node has.",
)
@click.pass_context
def graph(
    ctx: click.Context,
    /,
    job: str | None,
    output: str | None,
    to: Path | None,
    everything: bool,  # noqa: FBT001 - click passes it by name
) -> int:
    """Show the ROS nodes, their machines, and the topics between them.

    Exit code 1 if something is wrong: a node is missing or does not answer, a pod is not ready,
    types of a topic differ.
    """
    from rigel_graph.commands import graph as actions
    from rigel_graph.commands.expect import name_expected

    form = output or (ENDINGS.get(to.suffix, "text") if to else "text")
    found = actions.graph(settings(ctx), job)
    expected = name_expected(settings(ctx), job) if form == "foxglove" else ()
    show(render(found, form, everything=everything, expected=expected), form, to)
    return 0 if found.ok else 1


def show(text: str, form: str, to: Path | None) -> None:
    """Print a text, or write it to a file atomically: as a picture if that is the form.

    Raises:
        UserError: the file cannot be written.
        CommandFailed: Graphviz is not installed, or failed.
    """
    from rigel_graph.commands import graph as actions
    from rigel_k8s.errors import UserError

    if to is None:
        click.echo(text, nl=False)
        sys.stdout.flush()
        return
    beside = to.with_name(f".{to.name}.new")
    try:
        beside.write_text(click.unstyle(text), encoding="utf-8")
        if form in PICTURES:
            actions.paint(text, form, beside)
        beside.replace(to)
    except OSError as error:
        raise UserError(f"cannot write {to}: {error.strerror}") from error
    finally:
        beside.unlink(missing_ok=True)


def render(found: LiveGraph, form: str, *, everything: bool, expected: Collection[str] = ()) -> str:
    """Return a graph in a form; a picture as what Graphviz draws it from."""
    from rigel_graph.commands.graph import picture_of
    from rigel_graph.drawing import write_dot
    from rigel_graph.layout import make_layout

    if form == "json":
        return json.dumps(graph_json(found), indent=2) + "\n"
    if form == "foxglove":
        return json.dumps(make_layout(found.graph.topics, expected), indent=2) + "\n"
    picture = picture_of(found, everything=everything)
    return graph_text(found, picture) if form == "text" else write_dot(picture)


def graph_json(found: LiveGraph) -> dict[str, Any]:
    """Return a complete graph for scripts (docs/rosgraph.md)."""
    import attrs

    return {
        "release": found.release.name,
        "namespace": found.release.namespace,
        "ok": found.ok,
        **attrs.asdict(found.graph, filter=lambda field, _: field.name not in OMITTED),
        "problems": [problem.to_json() for problem in found.problems],
    }


def graph_text(found: LiveGraph, picture: Picture) -> str:
    """Return a graph as text: nodes by machine, topics, services, problems."""
    from rigel_k8s.cli.tables import table

    where = f"release {found.release.name} in namespace {found.release.namespace}"
    parts = [where, *(group_text(picture, group) for group in picture.groups)]
    rows = [topic_cells(found, picture, name) for name in sorted(p.name for p in picture.pills)]
    if rows:
        heads = ["TOPIC", "TYPE", "RATE", "FROM", "TO"]
        if any(topic.shared for topic in found.graph.topics):
            heads.append("BY SHARED MEMORY")
        lines = table(heads, [row[: len(heads)] for row in rows]).splitlines()
        bad = {pill.name for pill in picture.pills if pill.bad}
        parts.append("\n".join(redden(line, line.split(" ")[0] in bad) for line in lines))
    services = [one for one in found.graph.services if one.is_public]
    cells = [[one.name, one.type or "-", ", ".join(one.providers)] for one in services]
    parts.append(table(["SERVICE", "TYPE", "OF"], cells) if cells else "")
    parts.append("\n".join(problem_lines(found)))
    return "\n\n".join(part for part in parts if part) + "\n"


def group_text(picture: Picture, group: str) -> str:
    """Return the nodes of a machine, each with what it publishes and subscribes to."""
    shown = {box.name: box for box in picture.boxes if box.group == group}
    width = max(len(make_printable(name)) for name in shown)
    lines = [click.style(group, bold=True)]
    for name, box in sorted(shown.items()):
        sent = [arrow.topic for arrow in picture.arrows if arrow.node == name and arrow.out]
        heard = [arrow.topic for arrow in picture.arrows if arrow.node == name and not arrow.out]
        words = [
            part for part in (box.wrong, arrow_text("->", sent), arrow_text("<-", heard)) if part
        ]
        padded = make_printable(name).ljust(width)
        lines.append(redden(f"  {padded}  {'  '.join(words)}".rstrip(), box.bad))
    return "\n".join(lines)


def arrow_text(sign: str, topics: list[str]) -> str:
    """Return topics behind an arrow, "" for none."""
    return f"{sign} {', '.join(map(make_printable, sorted(topics)))}" if topics else ""


def topic_cells(found: LiveGraph, picture: Picture, name: str) -> list[str]:
    """Return a topic's row."""
    (topic,) = (topic for topic in found.graph.topics if topic.name == name)
    (pill,) = (pill for pill in picture.pills if pill.name == name)
    counts = str(len(topic.publishers)), str(len(topic.subscribers))
    shared = ", ".join(f"{one} -> {other}" for one, other in topic.shared)
    return [name, topic.type or "-", pill.rate or "-", *counts, shared or "-"]


def problem_lines(found: LiveGraph) -> Iterator[str]:
    for problem in found.problems:
        text = make_printable(problem.text, most=None)
        yield click.style(text, fg="red", bold=problem.is_error or None)


def redden(line: str, bad: bool) -> str:  # noqa: FBT001 - the condition itself
    """Return a line, in red if it is bad."""
    return click.style(line, fg="red") if bad else line

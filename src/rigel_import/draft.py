"""A draft: nodes and options on their way into a Rigelfile, and its text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.text import plural
from rigel_k8s.yaml_text import document

#: What marks the use of a var inside of a text; no file of a robot contains these characters.
VAR_START, VAR_END = "\ue000", "\ue001"
WIDTH = 100
DEPLOY = {"plugin": "rigel_k8s.OrchestrationPlugin"}
#: An opening brace of a template that stands for itself.
LITERAL = '{{ "{{" }}'
#: Lines of a summary; more remarks than fit are counted.
MOST_LINES = 10


def use_var(name: str) -> str:
    """Return the use of a var as a part of a text: `{{ vars.NAME }}` in the Rigelfile."""
    return f"{VAR_START}{name}{VAR_END}"


@attrs.frozen(order=True)
class Place:
    """A place in a file; lines start at 1."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


@attrs.frozen
class Remark:
    """Something that is not carried over, or works differently from how it looks.

    Attributes:
        message: what, and what takes its place, in one sentence without a full stop.
        node: the key of the node that it is about; None: all of it.
    """

    place: Place
    message: str
    node: str | None = None


@attrs.frozen
class Draft:
    """What becomes a Rigelfile.

    Attributes:
        name: the robot's, which its namespace gets.
        distro: the ROS distribution.
        nodes: the options of each node, by key, as docs/reference.md has them.
        options: the options of the job that deploys them, beside `nodes`.
        vars: the Rigelfile's.
        jobs: jobs that come before it, as those that build an image.
        remarks: in the order of the files.
        files: texts of files that stand beside the Rigelfile, by their paths.
    """

    name: str
    distro: str
    nodes: Mapping[str, Mapping[str, Any]]
    options: Mapping[str, Any] = attrs.field(factory=dict)
    vars: Mapping[str, Any] = attrs.field(factory=dict)
    jobs: Mapping[str, Mapping[str, Any]] = attrs.field(factory=dict)
    remarks: tuple[Remark, ...] = ()
    files: Mapping[str, str] = attrs.field(factory=dict)


def write_rigelfile(draft: Draft, command: str) -> str:
    """Return a Rigelfile that deploys a draft's nodes.

    Texts with "{{" in them stand for themselves. If jobs come before the deploy, the sequence `all`
    runs all of them.

    Args:
        command: the command line that made it.
    """
    lines = [f"# Made by `{command}`.", *_indent({"application": {"distro": draft.distro}}, 0)]
    if draft.vars:
        lines += _indent({"vars": draft.vars}, 0)
    lines += _indent({"jobs": {**draft.jobs, "deploy": DEPLOY}}, 0)
    lines.append("    with:")
    lines += _indent({"namespace": object_name(draft.name)}, 6)
    lines += [*_comment(draft, None, 6), *_indent(draft.options, 6), "      nodes:"]
    for key, options in draft.nodes.items():
        lines += [*_comment(draft, key, 8), *_indent({key: options}, 8)]
    if draft.jobs:
        stage = {"jobs": [*draft.jobs, "deploy"]}
        lines += _indent({"sequences": {"all": {"stages": [stage]}}}, 0)
    return "\n".join([*lines, ""])


def summarize(draft: Draft, target: str) -> Iterator[str]:
    """Yield at most ten lines that say what was made, and what was not carried over.

    Args:
        target: where the Rigelfile was written.
    """
    yield f"{target}: {plural(len(draft.nodes), 'node')} for ROS {draft.distro}"
    shown = draft.remarks[: MOST_LINES - 3]
    for remark in shown:
        about = f"{remark.node}: " if remark.node else ""
        yield f"  {remark.place}: {about}{remark.message}"
    if more := len(draft.remarks) - len(shown):
        yield f"  and {more} more, as comments in {target}"
    run = "rigel run sequence all" if draft.jobs else "rigel run deploy"
    yield f"Next: `rigel check`, then `{run}`"


def _indent(content: Mapping[str, Any], indent: int) -> Iterator[str]:
    """Yield the lines of a mapping as YAML; nothing for an empty one."""
    text = document(_escape(dict(content))) if content else ""
    yield from (f"{'':{indent}}{line}" for line in text.splitlines())


def _escape(value: Any) -> Any:
    """Return plain data in which a Rigelfile finds no templates but uses of vars."""
    if isinstance(value, str):
        text = value.replace("{{", LITERAL)
        return text.replace(VAR_START, "{{ vars.").replace(VAR_END, " }}")
    if isinstance(value, list | tuple):
        return [_escape(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _escape(item) for key, item in value.items()}
    return value


def _comment(draft: Draft, node: str | None, indent: int) -> Iterator[str]:
    """Yield comments about a node, or about the draft as a whole."""
    lead = f"{'':{indent}}# "
    for remark in draft.remarks:
        if remark.node == node:
            yield from textwrap.wrap(
                f"{remark.place}: {remark.message}".replace("\n", " "),
                width=WIDTH,
                initial_indent=lead,
                subsequent_indent=lead,
                break_long_words=False,
                break_on_hyphens=False,
            )

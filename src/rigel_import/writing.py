"""A draft as the text of a Rigelfile, and as lines for the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from rigel_import.draft import VAR_END, VAR_START, Draft
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.text import plural
from rigel_k8s.yaml_text import document

WIDTH = 100
DEPLOY = {"plugin": "rigel_k8s.OrchestrationPlugin"}
#: An opening brace of a template that stands for itself.
LITERAL = '{{ "{{" }}'
#: Lines of a summary; more remarks than fit are counted.
MOST_LINES = 10


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

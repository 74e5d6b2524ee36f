"""A whole Rigelfile for a stack, as text; what could not be carried over stands in comments."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any

import attrs

from rigel_k8s.distros import ROS2
from rigel_k8s.muto.remarks import Remark
from rigel_k8s.muto.stack import Stack
from rigel_k8s.muto.translation import Translation
from rigel_k8s.objects.naming import object_name
from rigel_k8s.rigelfile.source import strip_places
from rigel_k8s.yaml_text import document

#: Where no image is given; the user writes the right one over it.
PLACEHOLDER = "registry.example/robot:1"
#: What is taken for the ROS of a stack whose form does not say it.
DISTROS: Mapping[bool, str] = {False: "noetic", True: "jazzy"}
WIDTH = 100
#: An opening brace of a template that stands for itself.
LITERAL = '{{ "{{" }}'


@attrs.frozen
class Target:
    """What the Rigelfile says beside the stack; None: see PLACEHOLDER and DISTROS."""

    image: str | None = None
    distro: str | None = None

    def choose_distro(self, stack: Stack) -> str:
        """Return the ROS distribution."""
        return self.distro or DISTROS[stack.ros2]


def list_options(name: str, stack: Stack, target: Target) -> dict[str, Any]:
    """Return the options of the job that deploys a stack, beside its nodes."""
    ros2 = target.choose_distro(stack).lower() in ROS2
    return {
        "image": target.image or PLACEHOLDER,
        "deployment_name": _name_release(name, stack),
        **({"network": "peers"} if ros2 else {}),
    }


def write_rigelfile(name: str, stack: Stack, made: Translation, target: Target) -> str:
    """Return a Rigelfile whose one job deploys the nodes of a stack.

    Args:
        name: what the user called the stack.
    """
    distro = target.choose_distro(stack)
    job: dict[str, Any] = {"plugin": "rigel_k8s.OrchestrationPlugin"}
    lines = [
        f"# Made from {name} by `rigel muto convert`.",
        *_indent({"application": {"distro": distro}, "jobs": {"deploy": job}}, 0),
        "    with:",
        *([] if target.image else ["      # Write the image with the programs of the stack here."]),
        *_indent(list_options(name, stack, target), 6),
        *_list_comments(made.remarks, None, 6),
        "      nodes:",
    ]
    for key, options in made.nodes.items():
        lines += _list_comments(made.remarks, key, 8)
        lines += _indent({key: strip_places(options)}, 8)
    return "\n".join([*lines, ""])


def _name_release(name: str, stack: Stack) -> str:
    return object_name(stack.name or next(iter(stack.ids), "") or PurePath(name).stem)


def _indent(content: Mapping[str, Any], indent: int) -> Iterator[str]:
    """Yield the lines of a mapping as YAML."""
    text = document(_escape_templates(dict(content)))
    yield from (f"{'':{indent}}{line}" for line in text.splitlines())


def _escape_templates(value: Any) -> Any:
    """Return plain data in which a Rigelfile finds no templates."""
    if isinstance(value, str):
        return value.replace("{{", LITERAL)
    if isinstance(value, list):
        return [_escape_templates(item) for item in value]
    if isinstance(value, dict):
        return {key: _escape_templates(item) for key, item in value.items()}
    return value


def _list_comments(remarks: Sequence[Remark], node: str | None, indent: int) -> Iterator[str]:
    """Yield comments about a node, or about the stack as a whole."""
    lead = f"{'':{indent}}# "
    for remark in remarks:
        if remark.node != node:
            continue
        finding = remark.finding
        file = f"{finding.source.name}:" if finding.source else ""
        text = f"{file}{finding.span.line}:{finding.span.column}: {finding.message}"
        yield from textwrap.wrap(
            text.replace("\n", " "),
            width=WIDTH,
            initial_indent=lead,
            subsequent_indent=lead,
            break_long_words=False,
        )

"""A whole Rigelfile for a stack, as text; comments list what could not be carried over."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any

import attrs

from rigel_k8s.distros import CURRENT, ROS2
from rigel_k8s.objects.naming import object_name
from rigel_k8s.rigelfile.source import strip_places
from rigel_k8s.yaml_text import document
from rigel_muto.remarks import Remark
from rigel_muto.stack import Stack
from rigel_muto.translation import Translation

#: Used if no image is given; the user replaces it with the right one.
PLACEHOLDER = "registry.example/robot:1"
#: The ROS distribution for a stack that is for ROS 1.
LAST_ROS1 = "noetic"
ASSUMED = (
    f"nothing in this stack says for which ROS it is: this is for ROS 2 ({CURRENT}), as Muto is"
    f" since 2022; for ROS 1, convert it with `--distro {LAST_ROS1}`"
)
WIDTH = 100
IMAGE = "Write the image with the programs of the stack here."
DEPLOY: Mapping[str, Any] = {"plugin": "rigel_k8s.OrchestrationPlugin"}
#: Beside a Rigelfile that builds: the directory with the sources of an archive.
SOURCES = "sources"
#: The jobs that build an image from them. Its name is in one place.
BUILD_JOBS: Mapping[str, Any] = {
    "dockerfile": {"plugin": "rigel_k8s.DockerfilePlugin"},
    "build": {
        "plugin": "rigel_k8s.BuildXPlugin",
        "with": {"image": "{{ vars.image }}", "push": True, "platforms": []},
    },
}
DEPLOY_ALL = {"deploy": {"stages": [{"jobs": [*BUILD_JOBS, "deploy"]}]}}
#: An opening brace of a template that stands for itself.
LITERAL = '{{ "{{" }}'


@attrs.frozen
class Target:
    """What the Rigelfile sets beside the stack; no image is PLACEHOLDER."""

    image: str | None = None
    distro: str = CURRENT

    @property
    def is_ros2(self) -> bool:
        return self.distro.lower() in ROS2


def list_options(name: str, stack: Stack, target: Target) -> dict[str, Any]:
    """Return the options of the job that deploys a stack, beside its nodes."""
    return {
        "image": target.image or PLACEHOLDER,
        "deployment_name": name_release(name, stack),
        **({"network": "peers"} if target.is_ros2 else {}),
    }


def write_rigelfile(
    name: str, stack: Stack, made: Translation, target: Target, *, builds: bool
) -> str:
    """Return a Rigelfile that deploys the nodes of a stack.

    Args:
        name: what the user called the stack.
        builds: it builds an image of the directory SOURCES beside it first.
    """
    options = _escape_templates(list_options(name, stack, target))
    lines = [f"# Made from {name} by `rigel muto convert`."]
    if builds:
        image = {"vars": {"image": options["image"]}}
        options["image"] = "{{ vars.image }}"
        lines += [
            "# `rigel run sequence deploy` builds an image of its sources and deploys it.",
            *_indent({"application": {"distro": target.distro, "dir": SOURCES}}, 0),
            *([] if target.image else ["# Write the name of the image here."]),
            *_indent(image, 0),
        ]
    else:
        lines += _indent({"application": {"distro": target.distro}}, 0)
    lines += _indent({"jobs": {**(BUILD_JOBS if builds else {}), "deploy": DEPLOY}}, 0)
    lines.append("    with:")
    if not (builds or target.image):
        lines.append(f"      # {IMAGE}")
    lines += [*_indent(options, 6), *_list_nodes(made)]
    if builds:
        lines += _indent({"sequences": DEPLOY_ALL}, 0)
    return "\n".join([*lines, ""])


def _list_nodes(made: Translation) -> Iterator[str]:
    """Yield global parameters and `nodes`, each with what is not carried over."""
    yield from _list_comments(made.remarks, None, 6)
    for key, option in made.options.items():
        yield from _indent(_escape_templates({key: strip_places(option)}), 6)
    yield "      nodes:"
    for key, options in made.nodes.items():
        yield from _list_comments(made.remarks, key, 8)
        yield from _indent(_escape_templates({key: strip_places(options)}), 8)


def name_release(name: str, stack: Stack) -> str:
    """Return the name of the release: the stack's, or that of its file."""
    return object_name(stack.name or next(iter(stack.ids), "") or PurePath(name).stem)


def _indent(content: Mapping[str, Any], indent: int) -> Iterator[str]:
    """Yield the lines of a mapping as YAML."""
    text = document(dict(content))
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

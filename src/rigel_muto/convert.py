"""muto convert: a stack of Eclipse Muto as a Rigelfile; comments list what is not carried over."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import attrs

from rigel_build.recipe import Recipe
from rigel_k8s.app.checks.application import check
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.errors import UserError
from rigel_k8s.objects.naming import object_name
from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile import Finding, Source, place, problems_error, render, structure
from rigel_k8s.rigelfile.findings import sort_findings
from rigel_k8s.rigelfile.source import node_of, strip_places
from rigel_k8s.ros import CURRENT, DISTROS_2
from rigel_k8s.system.trees import File, Tree, write_tree
from rigel_k8s.yaml_text import document
from rigel_muto.archives import find_archive, translate_archive, unpack_archive
from rigel_muto.opening import Find, Twin, open_stack
from rigel_muto.options import Muto
from rigel_muto.remarks import NotFound, Remark, Unreadable, list_findings, note
from rigel_muto.stack import Stack
from rigel_muto.translation import Translation, require_nodes, translate

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
class Converted:
    """A Rigelfile, and warnings about the stack.

    Attributes:
        text: the Rigelfile's.
        warnings: rendered.
        sources: what the Rigelfile builds an image from, in the directory SOURCES.
    """

    text: str
    warnings: tuple[str, ...]
    sources: Tree = attrs.field(factory=dict)


def convert(source: Muto, image: str | None = None, distro: str | None = None) -> Converted:
    """Return the Rigelfile that deploys a stack.

    Args:
        source: the stack; files and ids are searched for in the working directory.
        image: the image with its programs; None: a placeholder.
        distro: the ROS distribution; None: one that fits the stack.

    Raises:
        ProblemsError: something is wrong with the stack, with its places; or it needs a build.
        UserError: the stack does not exist, or may not be read.
        RigelK8sError: the Ditto with the stack cannot be reached, or refuses.
    """
    return _convert(source, image, distro, builds=False)


def write(
    source: Muto, directory: Path, image: str | None = None, distro: str | None = None
) -> Converted:
    """Write a new directory with the Rigelfile that deploys a stack, and an archive's sources.

    Raises: as convert; and UserError if the directory exists. Nothing is written then.
    """
    made = _convert(source, image, distro, builds=True)
    sources = {f"{SOURCES}/{path}": entry for path, entry in made.sources.items()}
    write_tree({"Rigelfile": File(made.text.encode()), **sources}, directory)
    return made


def _convert(source: Muto, image: str | None, distro: str | None, *, builds: bool) -> Converted:
    """Return a stack's Rigelfile; that of an archive only if it may have sources beside it."""
    name = str(source.stack)
    nothing = Source(name, "")
    sources: Tree = {}
    try:
        stack, find = _open(name, source)
        archive = find_archive(stack) if builds else None
        given = {name: text_of(value) for name, value in source.args.items()}
        if archive:
            sources = unpack_archive(archive)
            directory = Recipe(distro or CURRENT, base="", source_name=SOURCES).sources
            key = name_release(name, stack)
            made = translate_archive(archive, key, sources, directory, given)
        else:
            ros2 = None if distro is None else Target(image, distro).is_ros2
            made = require_nodes(stack, translate(stack, given, find, ros2=ros2))
    except NotFound as error:
        hint = "give a file, the id of a stack in a file of the working directory or at --twin-url"
        raise UserError(str(error), hint=hint) from error
    except Unreadable as error:
        raise problems_error(nothing, [error.remark.finding]) from error
    target = Target(image, distro or (LAST_ROS1 if made.ros2 is False else CURRENT))
    about = list_findings(made.remarks, strict=source.strict)
    findings = sort_findings([*about, *_check(name, stack, made, target)])
    if any(finding.severity == "error" for finding in findings):
        raise problems_error(nothing, findings)
    if distro is None and made.ros2 is None and not archive:
        assumed = note(stack.place, ASSUMED, "assumed-ros")
        made = attrs.evolve(made, remarks=(assumed, *made.remarks))
        findings = (assumed.finding, *findings)
    text = write_rigelfile(name, stack, made, target, builds=bool(archive))
    return Converted(text, tuple(render(nothing, one) for one in findings), sources)


def _open(name: str, source: Muto) -> tuple[Stack, Find]:
    """Return the stack, and a function that finds the stacks that it refers to."""
    path = Path(name)
    home = path.parent if path.exists() else Path()
    url = source.twin_url
    ask = Twin(url, source.access, os.environ, {}).find if url else None
    return open_stack(name, Path(), home, ask, source.references)


def _check(name: str, stack: Stack, made: Translation, target: Target) -> Iterator[Finding]:
    """Yield the findings of `rigel check`, at their places in the stack."""
    at = stack.place
    options = {k: node_of(v, at) for k, v in list_options(name, stack, target).items()}
    nodes = attrs.evolve(at, value=dict(made.nodes), raw=None)
    root = attrs.evolve(at, value={**options, **made.options, "nodes": nodes}, raw=None)
    found = structure(root, OrchestrationOptions)
    yield from (place(root, problem) for problem in found.problems)
    if found.draft is not None:
        problems = check(found.draft, target.distro)
        sure = (problem for problem in problems if not found.doubts.may_explain(problem.path))
        yield from (place(root, problem) for problem in sure)


@attrs.frozen
class Target:
    """What the Rigelfile sets beside the stack; no image is PLACEHOLDER."""

    image: str | None = None
    distro: str = CURRENT

    @property
    def is_ros2(self) -> bool:
        return self.distro.lower() in DISTROS_2


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

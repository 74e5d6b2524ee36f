"""muto convert: a stack of Eclipse Muto as a Rigelfile."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import attrs

from rigel_build.recipe import Recipe
from rigel_k8s.app.checks.application import check
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.distros import CURRENT
from rigel_k8s.errors import UserError
from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile import Finding, Source, place, problems_error, render, structure
from rigel_k8s.rigelfile.findings import sort_findings
from rigel_k8s.rigelfile.source import node_of
from rigel_k8s.system.trees import File, Tree, write_tree
from rigel_muto.archives import find_archive, translate_archive, unpack_archive
from rigel_muto.opening import Find, Twin, open_stack
from rigel_muto.options import Muto
from rigel_muto.remarks import NotFound, Unreadable, list_findings, note
from rigel_muto.stack import Stack
from rigel_muto.translation import Translation, require_nodes, translate
from rigel_muto.writing import (
    ASSUMED,
    LAST_ROS1,
    SOURCES,
    Target,
    list_options,
    name_release,
    write_rigelfile,
)


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

"""muto convert: a stack of Eclipse Muto as a Rigelfile."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import attrs

from rigel_k8s.app.checks.application import check
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.errors import UserError
from rigel_k8s.muto.converting import Target, list_options, write_rigelfile
from rigel_k8s.muto.library import NotFound
from rigel_k8s.muto.opening import open_stack
from rigel_k8s.muto.options import Muto
from rigel_k8s.muto.remarks import Unreadable, list_findings
from rigel_k8s.muto.stack import Stack
from rigel_k8s.muto.translation import Translation, require_nodes, translate
from rigel_k8s.muto.twin import Twin
from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile import Finding, Source, place, problems_error, render, structure
from rigel_k8s.rigelfile.findings import sort_findings
from rigel_k8s.rigelfile.source import node_of


@attrs.frozen
class Converted:
    """A Rigelfile's text, and what there is to say about the stack, rendered."""

    text: str
    warnings: tuple[str, ...]


def convert(source: Muto, target: Target) -> Converted:
    """Return the Rigelfile that deploys a stack.

    Args:
        source: the stack; files and ids are looked for in the working directory.

    Raises:
        ProblemsError: something is wrong with the stack, with its places.
        UserError: there is no such stack, or it may not be read.
        RigelK8sError: the Ditto with the stack cannot be reached, or refuses.
    """
    path = Path(source.name)
    home = path.parent if path.exists() else Path()
    nothing = Source(source.stack, "")
    given = {name: text_of(value) for name, value in source.args.items()}
    url = source.base_url
    ask = Twin(url, source.access, os.environ, {}).find if url else None
    try:
        stack, find = open_stack(source.name, Path(), home, ask)
        made = require_nodes(stack, translate(stack, given, find))
    except NotFound as error:
        hint = "name a file, the id of a stack in a file of the working directory, or a URL"
        raise UserError(str(error), hint=hint) from error
    except Unreadable as error:
        raise problems_error(nothing, [error.remark.finding]) from error
    about = list_findings(made.remarks, strict=source.strict)
    findings = sort_findings([*about, *_check(source.stack, stack, made, target)])
    if any(finding.severity == "error" for finding in findings):
        raise problems_error(nothing, findings)
    text = write_rigelfile(source.stack, stack, made, target)
    return Converted(text, _render(nothing, findings))


def _check(name: str, stack: Stack, made: Translation, target: Target) -> Iterator[Finding]:
    """Yield what `rigel check` would find, at its place in the stack."""
    at = stack.place
    options = {k: node_of(v, at) for k, v in list_options(name, stack, target).items()}
    nodes = attrs.evolve(at, value=dict(made.nodes), raw=None)
    root = attrs.evolve(at, value={**options, "nodes": nodes}, raw=None)
    found = structure(root, OrchestrationOptions)
    yield from (place(root, problem) for problem in found.problems)
    if found.draft is not None:
        problems = check(found.draft, target.choose_distro(stack))
        sure = (problem for problem in problems if not found.doubts.may_explain(problem.path))
        yield from (place(root, problem) for problem in sure)


def _render(source: Source, findings: tuple[Finding, ...]) -> tuple[str, ...]:
    return tuple(render(source, finding) for finding in findings)

"""muto convert: a stack of Eclipse Muto as a Rigelfile."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.muto.converting import Target, write_rigelfile
from rigel_k8s.muto.library import NotFound, open_stack
from rigel_k8s.muto.remarks import Unreadable, list_findings
from rigel_k8s.muto.translation import translate
from rigel_k8s.rigelfile import Finding, Source, problems_error, render
from rigel_k8s.rigelfile.findings import sort_findings


@attrs.frozen
class Converted:
    """A Rigelfile's text, and what there is to say about the stack, rendered."""

    text: str
    warnings: tuple[str, ...]


def convert(stack: str, given: Mapping[str, str], target: Target, *, strict: bool) -> Converted:
    """Return the Rigelfile that deploys a stack.

    Args:
        stack: a file, or the id of a stack in the files of the working directory.
        given: values of the stack's arguments.
        strict: refuse a stack of which something is not carried over.

    Raises:
        ProblemsError: something is wrong with the stack, with its places.
        UserError: there is no such stack, or it may not be read.
    """
    path = Path(stack)
    home = path.parent if path.exists() else Path()
    nothing = Source(stack, "")
    try:
        found, library = open_stack(stack, Path(), home)
        made = translate(found, given, library.find)
    except NotFound as error:
        hint = "name a file, or the id of a stack in a file of the working directory"
        raise UserError(str(error), hint=hint) from error
    except Unreadable as error:
        raise problems_error(nothing, [error.remark.finding]) from error
    findings = sort_findings(list_findings(made.remarks, strict=strict))
    if any(finding.severity == "error" for finding in findings):
        raise problems_error(nothing, findings)
    return Converted(write_rigelfile(stack, found, made, target), _render(nothing, findings))


def _render(source: Source, findings: tuple[Finding, ...]) -> tuple[str, ...]:
    return tuple(render(source, finding) for finding in findings)

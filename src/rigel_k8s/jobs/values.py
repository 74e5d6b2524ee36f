"""A Rigelfile's values as jobs and matrices need them, before and during a run.

It joins rigelfile/, which finds places, and job types, which find problems.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.jobs.job import JobOptions
from rigel_k8s.jobs.steps import Branches, Job
from rigel_k8s.jobs.waves import find_limit_fault
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import (
    Finding,
    Rigelfile,
    YamlNode,
    place,
    preview,
    problems_error,
    realise,
    render,
    render_node,
    strip_places,
)
from rigel_k8s.rigelfile.limits import MOST_COMBINATIONS
from rigel_k8s.rigelfile.options import Preview, Realised


@attrs.frozen
class _Checked:
    """Options, and what is wrong with them."""

    seen: Preview | Realised
    findings: Sequence[Finding]


class Values:
    """Options and matrices of one Rigelfile."""

    def __init__(self, rigelfile: Rigelfile) -> None:
        self._rigelfile = rigelfile
        #: By use of a job: its options that wait for nothing, and the data they were made with.
        self._complete: dict[int, list[tuple[Mapping[str, Any], _Checked]]] = {}

    def preview(self, job: Job, known: Mapping[str, Any]) -> tuple[Any | None, list[Finding]]:
        """Return a job's options as far as they are known before the run, and what is wrong."""
        seen = preview(self._rigelfile, job.spec, job.overrides, known, job.type.options)
        findings = list(seen.findings)
        if seen.draft is not None:
            findings += seen.place_problems(self._check(job, seen.draft))
        if seen.complete and seen.options is not None:
            self._complete.setdefault(id(job), []).append((known, _Checked(seen, findings)))
        return seen.options, findings

    def realise(self, job: Job, data: Mapping[str, Any]) -> JobOptions:
        """Return a job's options, now that all data is available, checked.

        What waited for nothing in a preview is not made and checked again.

        Raises:
            ProblemsError: something in it is wrong, with places.
        """
        earlier = (made for known, made in self._complete.get(id(job), ()) if _has(data, known))
        made = next(earlier, None) or self._make(job, data)
        findings = [*made.findings]
        if check_files := getattr(job.type, "check_files", None):
            home = Path(self._rigelfile.source.name).absolute().parent
            application = self._rigelfile.application
            problems = check_files(made.seen.options, application, home)
            findings += made.seen.place_problems(problems)
        if any(finding.severity == "error" for finding in findings):
            raise problems_error(self._rigelfile.source, findings)

        def place_all(problems: Sequence[Problem]) -> Sequence[str]:
            return self._render(made.seen.place_problems(problems))

        return JobOptions(made.seen.options, made.seen.raw, self._render(findings), place_all)

    def _make(self, job: Job, data: Mapping[str, Any]) -> _Checked:
        real = realise(self._rigelfile, job.spec, job.overrides, data, job.type.options)
        findings = [*real.warnings, *real.place_problems(self._check(job, real.options))]
        return _Checked(real, findings)

    def _render(self, findings: Iterable[Finding]) -> tuple[str, ...]:
        return tuple(render(self._rigelfile.source, finding) for finding in findings)

    def _check(self, job: Job, options: Any) -> list[Problem]:
        problems = [*job.type.check(options, self._rigelfile.application)]
        if check_jobs := getattr(job.type, "check_jobs", None):
            problems += check_jobs(options, self._rigelfile.jobs)
        return problems

    def preview_matrix(
        self, step: Branches, known: Mapping[str, Any]
    ) -> tuple[Mapping[str, list[Any]] | None, list[Finding]]:
        """Return a matrix if it is known before the run, and what is wrong with it."""
        return self._render_matrix(step, known, final=False)

    def matrix(self, step: Branches, data: Mapping[str, Any]) -> Mapping[str, list[Any]]:
        """Return a matrix, now that all data is available.

        Raises:
            ProblemsError: it is not a matrix, with places.
        """
        matrix, findings = self._render_matrix(step, data, final=True)
        if matrix is None:
            raise problems_error(self._rigelfile.source, findings)
        return matrix

    def _render_matrix(
        self, step: Branches, data: Mapping[str, Any], *, final: bool
    ) -> tuple[Mapping[str, list[Any]] | None, list[Finding]]:
        if step.matrix is None:
            return {}, []
        seen = render_node(self._rigelfile, step.matrix, data, final=final)
        findings = [*seen.findings, *_matrix_faults(seen.node)]
        return (None if findings or not seen.complete else strip_places(seen.node)), findings


def _has(data: Mapping[str, Any], known: Mapping[str, Any]) -> bool:
    return all(key in data and data[key] == value for key, value in known.items())


def _matrix_faults(matrix: YamlNode) -> Iterator[Finding]:
    """Yield keys without a list, limits that are not a number above 0, too many combinations."""
    lengths = [len(n.value) for n in matrix.value.values() if isinstance(n.value, list)]
    if prod(lengths) > MOST_COMBINATIONS:
        message = f"this matrix has more than {MOST_COMBINATIONS} combinations"
        yield place(matrix, Problem((), message, "bad-matrix"))
    for key, node in matrix.value.items():
        if node.hole:
            continue
        if fault := find_limit_fault(key, strip_places(node)):
            yield place(node, Problem((), fault, "bad-matrix"))
        elif not isinstance(node.value, list):
            kind = type(node.value).__name__
            message = f"{key} of a matrix must be a list, not {kind}"
            yield place(node, Problem((), message, "bad-matrix"))

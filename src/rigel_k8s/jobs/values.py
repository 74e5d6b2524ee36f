"""A Rigelfile's values as jobs and matrices need them, before and during a run.

It joins rigelfile/, which finds places, and job types, which find problems. Before a run, values
that earlier jobs will store are unknown, and those of a written matrix are known: what depends on
the former is checked again when its job runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import prod
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.jobs.job import Exclusive, JobOptions
from rigel_k8s.jobs.matrix import combinations, find_limit_fault, label, split_limits
from rigel_k8s.jobs.steps import Branches, Job, Jobs, Serving, Step
from rigel_k8s.option_text import has_template
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
    strip_places,
)
from rigel_k8s.rigelfile.limits import MOST_COMBINATIONS
from rigel_k8s.rigelfile.options import Preview
from rigel_k8s.settings import Settings

#: Data by name, as far as it is known before a run.
Known = Mapping[str, Any]
#: What jobs hold, each with the job's name.
Held = dict[str, str]


class Values:
    """Options and matrices of one Rigelfile."""

    def __init__(self, rigelfile: Rigelfile) -> None:
        self._rigelfile = rigelfile
        #: By use of a job: its options that wait for nothing, and the data they were made with.
        self._complete: dict[int, list[tuple[Known, Preview]]] = {}

    def preview(self, job: Job, known: Known) -> Preview:
        """Return a job's options as far as they are known before the run, checked."""
        seen = preview(self._rigelfile, job.spec, job.overrides, known, job.type.options)
        if seen.draft is not None:
            seen = self._check(job, seen)
        if seen.complete and seen.options is not None:
            self._complete.setdefault(id(job), []).append((known, seen))
        return seen

    def is_complete(self, job: Job) -> bool:
        """Whether a preview of a job's options has found that they wait for nothing."""
        return id(job) in self._complete

    def realise(self, job: Job, data: Mapping[str, Any]) -> JobOptions:
        """Return a job's options, now that all data is available, checked.

        What waited for nothing in a preview is not made and checked again.

        Raises:
            ProblemsError: something in it is wrong, with places.
        """
        earlier = (seen for known, seen in self._complete.get(id(job), ()) if _has(data, known))
        seen = next(earlier, None) or self._check(
            job, realise(self._rigelfile, job.spec, job.overrides, data, job.type.options)
        )
        files = seen.check_files(job.type, self._rigelfile.application, self._rigelfile.source)
        findings = (*seen.findings, *files)
        if any(finding.severity == "error" for finding in findings):
            raise problems_error(self._rigelfile.source, findings)

        return JobOptions(
            options=seen.options,
            raw=seen.raw,
            warnings=self._render(findings),
            place=lambda problems: self._render(seen.place_problems(problems)),
        )

    def _check(self, job: Job, seen: Preview) -> Preview:
        """Return options with what the job type's checks find in them."""
        found = seen.check(job.type, self._rigelfile.application, self._rigelfile.jobs)
        return attrs.evolve(seen, findings=(*seen.findings, *found))

    def _render(self, findings: Iterable[Finding]) -> tuple[str, ...]:
        return tuple(render(self._rigelfile.source, finding) for finding in findings)

    def preview_matrix(
        self, step: Branches, known: Known
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
        scope = self._rigelfile.scope.with_data(data, final=final)
        node = scope.fill(step.matrix)
        findings = [*scope.findings, *_matrix_faults(node)]
        return (None if findings or node.has_hole() else strip_places(node)), findings


def _has(data: Mapping[str, Any], known: Known) -> bool:
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


def check_steps(
    steps: Step, rigelfile: Rigelfile, values: Values, settings: Settings
) -> list[Finding]:
    """Return what is wrong with the jobs under a step, for each combination that is known.

    Raises:
        UserError: two jobs that run side by side hold one key.
    """
    check = _StepsCheck(rigelfile, values, settings)
    check.visit(steps, {})
    return list(check.findings)


@attrs.frozen
class _StepsCheck:
    """A walk over a tree of steps; `findings` has each once."""

    rigelfile: Rigelfile
    values: Values
    settings: Settings
    findings: dict[Finding, None] = attrs.field(factory=dict)

    def visit(self, step: Step, known: Known, branch: str = "") -> Held:
        """Collect findings; return what the jobs below hold."""
        if isinstance(step, Job):
            return self._visit_job(step, known, branch)
        if isinstance(step, Jobs):
            held: Held = {}
            for inner in step.steps:
                held |= self.visit(inner, known, branch)
            return held
        if isinstance(step, Serving):
            side_by_side: tuple[Step, ...] = (*step.dependencies, step.jobs)
            return _combine(self.visit(one, known, branch) for one in side_by_side)
        return _combine(self._visit_branches(step, known, branch))

    def _visit_job(self, job: Job, known: Known, branch: str) -> Held:
        seen = self.values.preview(job, known)
        self.findings.update(dict.fromkeys(seen.findings))
        if seen.options is None or not isinstance(job.type, Exclusive):
            return {}
        key = job.type.exclusive(seen.options, self.rigelfile.application, self.settings)
        if key is None or has_template(key):  # a value that an earlier job will store
            return {}
        return {key: f"job {job.name}{f' ({branch})' if branch else ''}"}

    def _visit_branches(self, step: Branches, known: Known, branch: str) -> Iterator[Held]:
        matrix, findings = self.values.preview_matrix(step, known)
        self.findings.update(dict.fromkeys(findings))
        for combination in combinations(split_limits(matrix or {})[0]):
            name = ", ".join(filter(None, (branch, label(combination))))
            yield self.visit(step.body, {**known, **combination}, name)


def _combine(parts: Iterable[Held]) -> Held:
    """Return what jobs that run side by side hold together; UserError if two hold one key."""
    held: Held = {}
    for part in parts:
        for key, where in part.items():
            if key in held:
                raise UserError(
                    f"{held[key]} and {where} would work on {key} at the same time",
                    hint="run them one after the other, or give them different names",
                )
        held.update(part)
    return held

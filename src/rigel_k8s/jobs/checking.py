"""What is wrong with a tree of steps, before any of it runs.

Values that earlier jobs will store are unknown here, those of a written matrix are known: what
depends on the former is checked again when its job runs (execution.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.errors import UserError
from rigel_k8s.jobs.matrix import combinations, label
from rigel_k8s.jobs.steps import Branches, Job, Jobs, Serving, Step
from rigel_k8s.jobs.waves import split_limits
from rigel_k8s.option_text import has_template
from rigel_k8s.rigelfile import Finding
from rigel_k8s.settings import Application, Settings

Known = Mapping[str, Any]
#: A job and the data known so far to its options (None: something is wrong) and what is wrong.
Options = Callable[[Job, Known], tuple[Any | None, Sequence[Finding]]]
#: A matrix and the data known so far to {key: values} (None: not known yet) and what is wrong.
Matrix = Callable[[Branches, Known], tuple[Mapping[str, list[Any]] | None, Sequence[Finding]]]
Held = dict[str, str]


class JobPreview:
    """Checks every job of a tree, once for each combination that is known."""

    def __init__(
        self, options: Options, matrix: Matrix, application: Application, settings: Settings
    ) -> None:
        self._options = options
        self._matrix = matrix
        self._application = application
        self._settings = settings
        self._findings: dict[Finding, None] = {}

    def check(self, steps: Step) -> Sequence[Finding]:
        """Return what is wrong with the jobs under a step, each finding once.

        Raises:
            UserError: two jobs that run side by side hold one key.
        """
        self._check(steps, {})
        return tuple(self._findings)

    def _check(self, step: Step, known: Known, branch: str = "") -> Held:
        """Collect findings; return the keys that jobs below hold, each with the job's name."""
        if isinstance(step, Job):
            return self._check_job(step, known, branch)
        if isinstance(step, Jobs):
            return {
                k: w for inner in step.steps for k, w in self._check(inner, known, branch).items()
            }
        if isinstance(step, Serving):
            return self._check_serving(step, known, branch)
        return self._check_branches(step, known, branch)

    def _check_job(self, job: Job, known: Known, branch: str) -> Held:
        options, findings = self._options(job, known)
        self._findings.update(dict.fromkeys(findings))
        if options is None:
            return {}
        exclusive = getattr(job.type, "exclusive", None)
        key = exclusive(options, self._application, self._settings) if exclusive else None
        if key is None or has_template(key):  # a value that an earlier job will store
            return {}
        return {key: f"job {job.name}{f' ({branch})' if branch else ''}"}

    def _check_serving(self, step: Serving, known: Known, branch: str) -> Held:
        held = [self._check_job(job, known, branch) for job in step.dependencies]
        return _combine([*held, self._check(step.jobs, known, branch)])

    def _check_branches(self, step: Branches, known: Known, branch: str) -> Held:
        matrix, findings = self._matrix(step, known)
        self._findings.update(dict.fromkeys(findings))
        if matrix is None:
            return self._check(step.body, known, branch)
        chosen = combinations(split_limits(matrix)[0])
        return _combine(self._check_each(step, chosen, known, branch))

    def _check_each(
        self, step: Branches, chosen: list[dict[str, Any]], known: Known, branch: str
    ) -> Iterator[Held]:
        for combination in chosen:
            name = ", ".join(part for part in (branch, label(combination)) if part)
            yield self._check(step.body, {**known, **combination}, name)


def _combine(parts: Iterator[Held] | list[Held]) -> Held:
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

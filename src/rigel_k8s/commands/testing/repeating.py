"""Several runs of the same tests, some at the same time: how often each test passes.

Runs are threads, and Ctrl-C reaches the main thread alone: it stops the scope that all share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs

from rigel_k8s.app.deploying.guests import State
from rigel_k8s.app.generation import generation_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.testing import find_collisions
from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.commands.testing.results import RUN, Result, remove_results, write_results
from rigel_k8s.commands.testing.run import Trial, run_tests
from rigel_k8s.errors import Interrupted, JobFailed, RigelK8sError, UserError
from rigel_k8s.jobs.importing import importable
from rigel_k8s.jobs.job import Exclusive, JobReporter
from rigel_k8s.jobs.runner import Prepared
from rigel_k8s.jobs.steps import list_jobs
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.network.plan import domain
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import render
from rigel_k8s.system.threads import parallel

#: So many runs in a row have no DDS domain in common, if drawing that often is enough for it.
APART, DRAWS = 30, 100
WORST_FIRST: Sequence[State] = ("failed", "unknown", "passed")


def repeat_tests(
    trial: Trial, prepared: Prepared, report: JobReporter, *, times: int, width: int
) -> tuple[list[tuple[str, Result]], RigelK8sError | None]:
    """Do several runs, up to `width` at the same time; one that fails ends no other one.

    What run 3 leaves is in the folder 3 of the trial's `output`.

    Returns:
        What sum_up returns, and why the runs ended early, if they did.

    Raises:
        UserError: they would disturb each other; nothing was deployed.
    """
    if trial.settings.namespace and (width > 1 or trial.keep):
        raise UserError(
            "with -n all runs use one namespace: each must delete what it has tested before the"
            " next one begins",
            hint="leave out -n: each run makes a namespace; or leave out --parallel and --keep",
        )
    if width > 1:
        require_apart(prepared)
    remove_results(trial.output)
    namespaces, scope = draw_namespaces(trial, prepared, times), CancelScope()
    scope.on_cancel(
        lambda: report.warn("stopping, and deleting what is tested; Ctrl-C again ends at once")
    )
    runs: dict[int, list[Result]] = {}
    errors: list[RigelK8sError] = []

    def run(number: int) -> None:
        if errors or scope.cancelled.is_set():
            return
        part, results = report.child(str(number)), runs.setdefault(number, [])
        own = attrs.evolve(trial, output=trial.output / str(number))
        settings = attrs.evolve(prepared.settings, namespace=namespaces[number - 1])
        try:
            run_tests(own, attrs.evolve(prepared, settings=settings), part, results, scope.part())
        except RigelK8sError as error:
            if all(one.name != RUN for one in results):
                results.append(Result(trial.name, RUN, "failed", message=error.message))
            if error.exit_code == 1 or (isinstance(error, JobFailed) and number > 1):
                part.warn("\n".join([f"this run has failed: {error.message}", *error.details]))
            else:  # what is wrong with the first is wrong with all
                errors.append(error)

    try:
        with importable(trial.settings.rigelfile.parent), interruptible(scope):
            parallel(run, range(1, times + 1), width=width)
    finally:
        every = [(n, one) for n, results in sorted(runs.items()) for one in results]
        named = [attrs.evolve(one, suite=f"{one.suite} {n}") for n, one in every]
        write_results(named, trial.output)
    failed = len({n for n, one in every if one.state == "failed"})
    report.line(
        f"{len(runs) - failed} of {len(runs)} runs have passed;"
        f" results, logs and files are in {trial.output}"
    )
    if scope.cancelled.is_set():
        return sum_up(runs), Interrupted(f"interrupted: {len(runs)} of {times} runs had begun")
    return sum_up(runs), next(iter(errors), None)


def sum_up(runs: Mapping[int, Sequence[Result]]) -> list[tuple[str, Result]]:
    """Return how often each test has passed, and its worst state, slowest time and first cause.

    It counts in the runs in which it has ended; RUN, which only those have that failed, in all.
    """
    found: dict[tuple[str, str], list[Result]] = {}
    for number, results in sorted(runs.items()):
        for one in results:
            cause = one.message and f"run {number}: {one.message}"
            found.setdefault((one.suite, one.name), []).append(attrs.evolve(one, message=cause))
    rows = []
    for ended in found.values():
        total = len(runs) if ended[0].name == RUN else len(ended)
        passed = total - sum(one.state != "passed" for one in ended)
        worst = min(ended, key=lambda one: WORST_FIRST.index(one.state))
        slowest = max(one.seconds for one in ended)
        rows.append((f"{passed} of {total}", attrs.evolve(worst, seconds=slowest)))
    return rows


def require_apart(prepared: Prepared) -> None:
    """Refuse jobs that two runs cannot do at the same time. Raises UserError, with all causes."""
    application, source, found = prepared.rigelfile.application, prepared.rigelfile.source, []
    for job in list_jobs(prepared.steps):
        seen = prepared.values.preview(job, {})
        if isinstance(seen.options, OrchestrationOptions):
            ros = generation_of(application.distro, seen.options.ros)
            shared = (
                Problem(path, message, "conflict", at_key=True)
                for path, message in find_collisions(seen.options, ros)
            )
            found += [render(source, one) for one in seen.place_problems(shared)]
        elif seen.options is not None and isinstance(job.type, Exclusive):
            key = job.type.exclusive(seen.options, application, prepared.settings)
            if key and str(prepared.settings.namespace) not in key:
                found.append(f"the job {job.name} of each run would work on {key}")
    if found:
        raise UserError(
            "runs at the same time would disturb each other",
            details=list(dict.fromkeys(found)),
            hint="leave out --parallel: each run begins when the one before has ended",
        )


def draw_namespaces(trial: Trial, prepared: Prepared, times: int) -> list[str]:
    """Return a namespace for each run, such that runs at the same time differ in DDS domains.

    A domain is a hash of the namespace, one of a hundred: two of ten are often the same.
    """
    distro = prepared.rigelfile.application.distro
    previews = [prepared.values.preview(job, {}).options for job in list_jobs(prepared.steps)]
    jobs = [one for one in previews if isinstance(one, OrchestrationOptions)]
    drawn: list[tuple[str, set[int | None]]] = []
    for _ in range(times):
        for _ in range(DRAWS):
            namespace = trial.draw_namespace()
            salts = ((one, f"{namespace}/{one.deployment_name}") for one in jobs)
            own = {domain(one.network, generation_of(distro, one.ros), salt) for one, salt in salts}
            if not any(own & other - {None} for _, other in drawn[-APART:]):
                break
        drawn.append((namespace, own))
    return [namespace for namespace, _ in drawn]

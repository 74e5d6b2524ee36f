"""down --sequence: the releases that a sequence deploys, such as the robots of a fleet."""

from __future__ import annotations

from collections.abc import Sequence

from rigel_k8s.commands import releases
from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.commands.targets import Jobs, Release, read_jobs
from rigel_k8s.errors import ClusterError, Interrupted, RigelK8sError, UserError
from rigel_k8s.jobs.deploying import HasRelease
from rigel_k8s.jobs.engine import make_failure
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.jobs.matrix import Outcome, count_failures, list_outcomes
from rigel_k8s.jobs.runner import list_steps
from rigel_k8s.jobs.steps import Step, list_uses
from rigel_k8s.jobs.values import Values
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.release.types import Plan, ReleaseId
from rigel_k8s.settings import Settings
from rigel_k8s.system.threads import parallel

#: Releases that are deleted at the same time.
WIDTH = 10


def down(
    settings: Settings, sequence: str, report: JobReporter, *, volumes: bool
) -> list[tuple[ReleaseId, Plan]]:
    """Delete the releases that a sequence deploys, those of its last stage first.

    Those of one stage are deleted side by side, and a failure stops none of them. The stages
    before it are then left alone, since the release that is left may need theirs.

    Returns:
        Each release and what was deleted of it; an empty plan if it did not exist.

    Raises:
        ClusterError: some could not be deleted; lists all, with the causes.
        Interrupted: by Ctrl-C; lists what is deleted and what is left.
        UserError: the sequence does not exist, or none of its releases does.
        ProblemsError: the name of a release waits for what a job stores.
    """
    jobs = read_jobs(settings)
    steps = list_steps(jobs.rigelfile, sequence, settings)
    with connect(settings) as cluster:
        stages = [list_releases(step, jobs, cluster) for step in steps.steps]
    plans: dict[ReleaseId, Plan] = {}
    outcomes: list[Outcome] = []
    with interruptible() as cancel:

        def end(release: ReleaseId) -> Outcome:
            name = describe(release)
            if cancel.is_set():
                return Outcome(name, "not begun")
            part = report.child(release.namespace)
            try:
                found = Release(connect(settings), release)
                plans[release] = releases.down(found, settings, part, cancel, volumes=volumes)
            except Interrupted:
                return Outcome(name, "stopped")
            except RigelK8sError as error:
                return Outcome(name, "failed", make_failure(name, error))
            return Outcome(name, "done")

        for stage in reversed(stages):
            if count_failures(outcomes):
                outcomes += [Outcome(describe(release), "not begun") for release in stage]
            else:
                outcomes += parallel(end, stage, width=WIDTH)
        require_done(outcomes, interrupted=cancel.is_set())
    if all(plan.is_empty for plan in plans.values()):
        raise UserError(
            f'no release of the sequence "{sequence}" exists',
            hint="list all releases with `rigel list -A`, or choose a cluster with --context",
        )
    return list(plans.items())


def require_done(outcomes: Sequence[Outcome], *, interrupted: bool) -> None:
    """Raise if not all releases are deleted."""
    details = list(list_outcomes(outcomes))
    hint = "run the same command again to delete the rest"
    if interrupted and any(outcome.state != "done" for outcome in outcomes):
        message = "interrupted before all releases were deleted"
        raise Interrupted(message, hint=hint, details=details)
    if failures := count_failures(outcomes):
        message = f"{failures} of {len(outcomes)} releases could not be deleted"
        raise ClusterError(message, hint=hint, details=details)


def list_releases(step: Step, jobs: Jobs, cluster: Cluster) -> list[ReleaseId]:
    """Return the releases that the jobs below a step deploy, each once. Raises as read_names."""
    values = Values(jobs.rigelfile)
    own: dict[ReleaseId, None] = {}
    for job, data in list_uses(step, lambda step, known: values.preview_matrix(step, known)[0]):
        if isinstance(job.type, HasRelease):
            release = jobs.find_release(job, jobs.read_names(job, data), cluster)
            if release is not None:
                own[release] = None
    return list(own)


def describe(release: ReleaseId) -> str:
    """Return a release's name for a list."""
    return f"{release.name} in {release.namespace}"

"""Which job, and so which release, a command is about.

A release on a cluster needs no Rigelfile: its revisions have all the information.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s import rigelfile as grammar
from rigel_k8s.app.partial import is_partial
from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.errors import ClusterError, ProblemsError, RigelK8sError, UserError
from rigel_k8s.jobs import registry
from rigel_k8s.jobs.job import JobContext, JobReporter
from rigel_k8s.jobs.steps import Job
from rigel_k8s.jobs.values import Values
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.naming import object_name
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem
from rigel_k8s.release import revisions
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rigelfile.model import ComponentSpec, Rigelfile
from rigel_k8s.settings import Application, Settings

if TYPE_CHECKING:
    from rigel_k8s.release.together import Part

NAME_NAMESPACE = "name the namespace with -n; `rigel list -A` lists all releases"
NAME_RELEASE = "name the release instead of the job; `rigel list -A` lists all releases"


@attrs.frozen
class TargetJob:
    """A job whose options are all known and right.

    Attributes:
        data: what a sequence passes to it.
        warnings: of its options' check, rendered.
        place: turns problems with the options into texts with their lines in the Rigelfile.
    """

    job: Job
    options: Any
    data: Mapping[str, Any]
    raw: Mapping[str, Any]
    application: Application
    warnings: Sequence[str]
    place: Callable[[Sequence[Problem]], Sequence[str]] = lambda found: list(map(str, found))

    @property
    def name(self) -> str:
        """The job's key in the Rigelfile."""
        return self.job.name

    def list_parts(
        self, settings: Settings, cluster: Cluster | None, report: JobReporter
    ) -> Sequence[Part]:
        """Return what it would deploy; nothing is written."""
        context = JobContext(
            self.name,
            self.application,
            report,
            settings,
            data=dict(self.data),
            raw=self.raw,
            place=self.place,
            dry=True,
        )
        kind: Any = self.job.type
        parts: Sequence[Part] = kind.parts(self.options, context, cluster)
        return parts


@attrs.frozen
class Release:
    """A release on a cluster, connected.

    Attributes:
        observability: the job's options of that name; None if it was not found by a job.
    """

    cluster: Cluster
    id: ReleaseId
    observability: Any = None


class NoSuchJob(UserError):
    """The Rigelfile has no job of that name.

    Args:
        close: a job whose name is nearly the same, if there is one.
    """

    def __init__(self, name: str, close: str | None, *, hint: str) -> None:
        meant = f', did you mean "{close}"?' if close else ""
        super().__init__(f'unknown job "{name}"{meant}', hint=hint)
        self.name = name
        self.close = close


def job_of(
    settings: Settings,
    name: str | None,
    rigelfile: Rigelfile | None = None,
    data: Mapping[str, Any] | None = None,
) -> TargetJob:
    """Return the named job, or the one that deploys the Rigelfile's application.

    Args:
        rigelfile: the content of the settings' file, if it was read before.
        data: what a sequence passes to the job.

    Raises:
        UserError: the job does not exist, or there are several releases and no name; lists them.
        ProblemsError: the job's options are wrong, or wait for data of other jobs.
    """
    rigelfile = rigelfile or load(settings)
    job = choose_job(rigelfile, settings, name)
    values = Values(rigelfile)
    _, findings = values.preview(job, data or {})
    if any(finding.severity == "error" for finding in findings):
        raise grammar.problems_error(rigelfile.source, findings)
    try:
        ready = values.realise(job, data or {})
    except ProblemsError as error:  # data is missing
        error.hint = "pass what a sequence would store: --data KEY=VALUE"
        raise
    return TargetJob(
        job,
        ready.options,
        data or {},
        ready.raw,
        rigelfile.application,
        ready.warnings,
        ready.place,
    )


def release(
    settings: Settings,
    name: str | None = None,
    nodes: Sequence[str] = (),
    *,
    named: bool = False,
) -> Release:
    """Return a release, connected.

    Args:
        name: a job of the Rigelfile, or a release of the cluster; the job, if both have the
            name. None is the one release of the Rigelfile. Of a job's options only the release's
            two names must be known.
        nodes: if the Rigelfile has several releases, choose the one with these nodes.
        named: without a Rigelfile, the only release of the namespace is not meant: what writes
            must not do it in a wrong directory.

    Raises: as job_of.
    """
    if not settings.rigelfile.exists() and is_default(settings.rigelfile):
        if name is None and named:
            raise UserError(
                f"{settings.rigelfile} does not exist, and no release is named",
                hint="name the release; `rigel list` lists those of a namespace",
            )
        cluster = connect(settings)
        if name is None:
            return find_only(cluster, settings)
        return name_release(cluster, settings, name)
    rigelfile = load(settings, patient=True)
    try:
        job = choose_job(rigelfile, settings, name, nodes)
    except NoSuchJob as error:
        return find_other(error, settings)
    options = names_of(rigelfile, job, settings)
    cluster = connect(settings)
    found = find_release(job, options, settings, cluster)
    if found is None:
        raise UserError(
            f'the job "{job.name}" has no release of its own',
            hint="see the stack with `rigel observe status`, Multus with `rigel network status`",
        )
    return Release(cluster, found, getattr(options, "observability", None))


def find_release(
    job: Job, options: Any, settings: Settings, cluster: Cluster | None
) -> ReleaseId | None:
    """Return the release that is a job's own; None without one."""
    find = getattr(job.type, "release", None)
    return find(options, settings, cluster) if find else None


def find_only(cluster: Cluster, settings: Settings) -> Release:
    """Return the only release of the namespace. Raises UserError without one, or with several."""
    namespace = settings.namespace or cluster.namespace
    names = sorted({one.release.name for one in list_releases(cluster, namespace)})
    if len(names) == 1:
        return name_release(cluster, settings, names[0])
    there = f"there are {', '.join(names)}" if names else "none exists"
    raise UserError(
        f"{settings.rigelfile} does not exist, and no release is named: {there} in the namespace"
        f" {namespace}",
        hint="name the release, and its namespace with -n; `rigel list -A` lists all",
    )


def is_default(rigelfile: Path) -> bool:
    """Whether no Rigelfile was named: `./Rigelfile` may be missing then."""
    return rigelfile == Settings().rigelfile


def name_release(cluster: Cluster, settings: Settings, name: str) -> Release:
    """Return a release by its name, without checking that it exists."""
    return Release(cluster, ReleaseId(settings.namespace or cluster.namespace, name))


def find_other(unknown: NoSuchJob, settings: Settings) -> Release:
    """Return the release with a name that is not a job of the Rigelfile.

    Without the right to list Secrets, as a viewer, it is not known whether it exists.

    Raises:
        NoSuchJob: the release does not exist either, or the name is nearly that of a job.
        ClusterError: the cluster could not be searched for it.
        UserError: the kubeconfig is wrong.
    """
    try:
        cluster = connect(settings)
        found = name_release(cluster, settings, unknown.name)
        exists = bool(revisions.records(cluster, found.id))
    except RigelK8sError as error:
        if unknown.close:
            raise unknown from error
        if isinstance(error, Forbidden):
            return found
        kind = UserError if isinstance(error, UserError) else ClusterError
        raise kind(
            f'"{unknown.name}" is not a job, and a release of that name could not be looked up: '
            f"{error.message}",
            hint=error.hint,
            details=[*filter(None, [unknown.hint]), *error.details],
        ) from error
    if not exists:
        raise unknown
    return found


def names(settings: Settings) -> list[str]:
    """Return the names of all jobs that deploy something."""
    rigelfile = load(settings, patient=True)
    return [job.name for job in list_jobs(rigelfile, settings) if hasattr(job.type, "parts")]


def list_named(settings: Settings) -> list[str]:
    """Return the names of all jobs that `release` finds a release by."""
    rigelfile = load(settings, patient=True)
    return [job.name for job in list_jobs(rigelfile, settings) if hasattr(job.type, "release")]


def node_names(settings: Settings, job: str | None = None) -> list[str]:
    """Return the keys of a job's nodes, and its other workloads. Raises as job_of."""
    rigelfile = load(settings, patient=True)
    return list_node_names(rigelfile, choose_job(rigelfile, settings, job), settings)


def list_node_names(rigelfile: Rigelfile, job: Job, settings: Settings) -> list[str]:
    """Return the keys of a job's nodes, and its other workloads. Raises as names_of."""
    if not hasattr(job.type, "workloads"):
        return []
    options = names_of(rigelfile, job, settings)
    return list(job.type.workloads(options, rigelfile.application))


def choose_job(
    rigelfile: Rigelfile, settings: Settings, name: str | None, nodes: Sequence[str] = ()
) -> Job:
    """Return the meant job: deploy and update jobs of one application count as one."""
    deploying = [job for job in list_jobs(rigelfile, settings) if hasattr(job.type, "parts")]
    if name is not None:
        return find_job(rigelfile, deploying, name)
    jobs = [job for job in deploying if hasattr(job.type, "workloads")]
    if not jobs:
        raise UserError(
            f"{rigelfile.source.name} has no orchestration job",
            hint="add a job with `plugin: rigel_k8s.OrchestrationPlugin`",
        )
    if len(jobs) == 1:  # most files: its options need not be read for its names
        return jobs[0]
    by_release: dict[tuple[str, str], list[Job]] = {}
    for job in jobs:
        options = names_of(rigelfile, job, settings)
        where = settings.namespace or str(options.namespace or "")
        by_release.setdefault((where, str(options.deployment_name)), []).append(job)
    if len(by_release) > 1 and nodes:
        having = [
            same for same in by_release.values() if has_nodes(rigelfile, same, settings, nodes)
        ]
        if len(having) == 1:
            return choose_whole(having[0])
    if len(by_release) > 1:
        listed = ", ".join(same[0].name for same in by_release.values())
        raise UserError("the Rigelfile has several releases", hint=f"name a job, one of: {listed}")
    return choose_whole(jobs)


def choose_whole(jobs: Sequence[Job]) -> Job:
    """Return the job of a release that describes all of it, if there is one."""
    return next((job for job in jobs if not is_partial(spec_keys(job.spec))), jobs[0])


def has_nodes(
    rigelfile: Rigelfile, jobs: Sequence[Job], settings: Settings, nodes: Sequence[str]
) -> bool:
    """Return whether the jobs of a release have all of some nodes, by key or ROS name."""
    there = {object_name(key) for job in jobs for key in list_node_names(rigelfile, job, settings)}
    return there.issuperset(map(object_name, nodes))


def list_jobs(rigelfile: Rigelfile, settings: Settings) -> Iterator[Job]:
    """Yield the jobs whose types are known."""
    directory = settings.rigelfile.absolute().parent
    for spec in rigelfile.jobs.values():
        with suppress(UserError):
            yield Job(spec, registry.job_type(spec.plugin, directory))


def find_job(rigelfile: Rigelfile, deploying: Sequence[Job], name: str) -> Job:
    """Return the job of that name."""
    by_name = {job.name: job for job in deploying}
    if name in by_name:
        return by_name[name]
    hint = f"jobs that deploy: {', '.join(by_name) or 'none'}"
    if name in rigelfile.jobs:
        raise UserError(f'the job "{name}" deploys nothing', hint=hint)
    raise NoSuchJob(name, grammar.find_nearest(name, by_name), hint=hint)


def spec_keys(spec: ComponentSpec) -> Mapping[str, Any]:
    """Return a job's `with` as far as it is in the file."""
    plain: dict[str, Any] = grammar.strip_places(spec.options)
    return plain


def names_of(
    rigelfile: Rigelfile, job: Job, settings: Settings, data: Mapping[str, Any] | None = None
) -> Any:
    """Return a job's options as far as they are known without a run, and the release's names.

    The settings' namespace replaces the job's, which then need not be known.

    Args:
        data: what a sequence's matrix passes to them.

    Raises:
        ProblemsError: something is wrong with them, or a name waits for data of a sequence.
    """
    source = (rigelfile, job.spec, job.overrides, data or {}, job.type.options)
    seen = grammar.preview(*source)
    if any(finding.severity == "error" for finding in seen.findings):
        raise grammar.problems_error(rigelfile.source, seen.findings)
    options = seen.options if seen.options is not None else seen.draft
    hint = None
    if has_template(str(getattr(options, "deployment_name", ""))):
        hint = NAME_RELEASE
    elif not settings.namespace and has_template(str(getattr(options, "namespace", ""))):
        hint = NAME_NAMESPACE
    if hint:
        try:
            grammar.realise(*source)
        except ProblemsError as error:
            error.hint = hint
            raise
    return options

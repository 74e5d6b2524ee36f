"""Which job, and so which release, a command is about.

A release on a cluster needs no Rigelfile: its revisions have all the information.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s import rigelfile as grammar
from rigel_k8s.app.application import is_partial
from rigel_k8s.app.deploying.target import release_key
from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.errors import ClusterError, ProblemsError, RigelK8sError, UserError
from rigel_k8s.jobs import registry
from rigel_k8s.jobs.deploying import Deploys, HasRelease
from rigel_k8s.jobs.job import HasWorkloads, JobContext
from rigel_k8s.jobs.steps import Job
from rigel_k8s.jobs.values import Values
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.naming import object_name
from rigel_k8s.option_text import has_template
from rigel_k8s.release import revisions
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rigelfile.model import ComponentSpec, Rigelfile
from rigel_k8s.settings import Settings

if TYPE_CHECKING:
    from rigel_k8s.release.part import Part

NAME_NAMESPACE = "name the namespace with -n; `rigel list -A` lists all releases"
NAME_RELEASE = "name the release instead of the job; `rigel list -A` lists all releases"


@attrs.frozen
class Jobs:
    """The jobs of a Rigelfile, and which of them a command means."""

    rigelfile: Rigelfile
    settings: Settings

    def list_jobs(self, able: type[Any]) -> list[Job]:
        """Return the jobs whose type has an interface of jobs/job.py."""
        directory = self.settings.rigelfile.absolute().parent
        jobs = []
        for spec in self.rigelfile.jobs.values():
            with suppress(UserError):  # its type is not known
                jobs.append(Job(spec, registry.job_type(spec.plugin, directory)))
        return [job for job in jobs if isinstance(job.type, able)]

    def choose(self, name: str | None, nodes: Sequence[str] = ()) -> Job:
        """Return the named job, or the one that deploys the Rigelfile's application.

        Several jobs of one release count as one: the one that describes all of it.

        Args:
            nodes: of several releases, the one that has all of these is meant.

        Raises:
            UserError: the job does not exist, or there are several releases and no name.
        """
        if name is not None:
            return self._find(name)
        jobs = self.list_jobs(HasWorkloads)
        if not jobs:
            raise UserError(
                f"{self.rigelfile.source.name} has no orchestration job",
                hint="add a job with `plugin: rigel_k8s.OrchestrationPlugin`",
            )
        if len(jobs) == 1:  # most files: its options need not be read for its names
            return jobs[0]
        by_release = defaultdict(list)
        for job in jobs:
            by_release[release_key(self.read_names(job), self.settings)].append(job)
        meant = list(by_release.values())
        if len(meant) > 1 and nodes:
            meant = [same for same in meant if self._have_nodes(same, nodes)]
        if len(meant) != 1:
            names = ", ".join(same[0].name for same in by_release.values())
            raise UserError(
                f"the Rigelfile has several releases{self._name_missing(jobs, nodes)}",
                hint=f"name a job, one of: {names}",
            )
        whole = [job for job in meant[0] if not is_partial(spec_keys(job.spec))]
        return (whole or meant[0])[0]

    def _find(self, name: str) -> Job:
        deploying = {job.name: job for job in self.list_jobs(Deploys)}
        if name in deploying:
            return deploying[name]
        if name in self.rigelfile.jobs:
            raise UserError(
                f'the job "{name}" deploys nothing',
                hint=f"jobs that deploy: {', '.join(deploying) or 'none'}",
            )
        raise self.unknown(name)[0]

    def unknown(self, name: str) -> tuple[UserError, str | None]:
        """Return the error for a name that no job has, and the job that was probably meant."""
        names = [job.name for job in self.list_jobs(Deploys)]
        close = grammar.find_nearest(name, names)
        meant = f', did you mean "{close}"?' if close else ""
        hint = f"jobs that deploy: {', '.join(names) or 'none'}"
        return UserError(f'unknown job "{name}"{meant}', hint=hint), close

    def _have_nodes(self, jobs: Sequence[Job], nodes: Sequence[str]) -> bool:
        there = {object_name(key) for job in jobs for key in self.list_nodes(job)}
        return there.issuperset(map(object_name, nodes))

    def _name_missing(self, jobs: Sequence[Job], nodes: Sequence[str]) -> str:
        known = sorted({key for job in jobs for key in self.list_nodes(job)})
        missing = (node for node in nodes if object_name(node) not in map(object_name, known))
        for node in missing:
            return f' and none has a node "{node}"{grammar.name_nearest(node, known)}'
        return ""

    def list_nodes(self, job: Job) -> list[str]:
        """Return the keys of a job's nodes, and its other workloads. Raises as read_names."""
        if not isinstance(job.type, HasWorkloads):
            return []
        return list(job.type.workloads(self.read_names(job), self.rigelfile.application))

    def read_names(self, job: Job, data: Mapping[str, Any] | None = None) -> Any:
        """Return a job's options as far as they are known without a run, and the release's names.

        The settings' namespace replaces the job's, which then need not be known.

        Args:
            data: what a sequence's matrix passes to them.

        Raises:
            ProblemsError: something is wrong with them, or a name waits for data of a sequence.
        """
        source = (self.rigelfile, job.spec, job.overrides, data or {}, job.type.options)
        seen = grammar.preview(*source)
        if any(finding.severity == "error" for finding in seen.findings):
            raise grammar.problems_error(self.rigelfile.source, seen.findings)
        options = seen.options if seen.options is not None else seen.draft
        hint = None
        if has_template(str(getattr(options, "deployment_name", ""))):
            hint = NAME_RELEASE
        elif not self.settings.namespace and has_template(str(getattr(options, "namespace", ""))):
            hint = NAME_NAMESPACE
        if hint:
            try:
                grammar.realise(*source)
            except ProblemsError as error:
                error.hint = hint
                raise
        return options

    def find_release(self, job: Job, options: Any, cluster: Cluster) -> ReleaseId | None:
        """Return the release that is a job's own; None without one."""
        if not isinstance(job.type, HasRelease):
            return None
        return job.type.release(options, self.settings, cluster)


def read_jobs(settings: Settings) -> Jobs:
    """Return the jobs of the settings' Rigelfile, whose variables need not all be known."""
    return Jobs(load(settings, patient=True), settings)


def names(settings: Settings, able: type[Any] = Deploys) -> list[str]:
    """Return the names of all jobs that deploy something, or of those with another interface."""
    return [job.name for job in read_jobs(settings).list_jobs(able)]


def list_namespaces(settings: Settings, cluster: Cluster) -> list[str]:
    """Return the namespaces that the settings or the Rigelfile's jobs name, else the context's.

    A Rigelfile that cannot be read names none.
    """
    found: list[str] = []
    if settings.rigelfile.exists() and not settings.namespace:
        with suppress(RigelK8sError):
            jobs = read_jobs(settings)
            for job in jobs.list_jobs(HasRelease):
                own = jobs.find_release(job, jobs.read_names(job), cluster)
                found += [own.namespace] if own else []
    return list(dict.fromkeys(found)) or [settings.namespace or cluster.namespace]


def node_names(settings: Settings, job: str | None = None) -> list[str]:
    """Return the keys of a job's nodes, and its other workloads. Raises as job_of."""
    jobs = read_jobs(settings)
    return jobs.list_nodes(jobs.choose(job))


def spec_keys(spec: ComponentSpec) -> Mapping[str, Any]:
    """Return a job's `with` as far as it is in the file."""
    plain: dict[str, Any] = grammar.strip_places(spec.options)
    return plain


@attrs.define
class Warnings:
    """A reporter that keeps warnings and shows nothing."""

    texts: list[str] = attrs.field(factory=list)

    def line(self, text: str) -> None:
        """Show nothing."""

    def warn(self, text: str) -> None:
        self.texts.append(text)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Show nothing."""

    def child(self, name: str) -> Warnings:
        return self


@attrs.frozen
class TargetJob:
    """A job that is looked at and not run; its options are all known and right.

    Attributes:
        warnings: of its options' check; what looks at it adds more.
    """

    type: Any
    options: Any
    context: JobContext
    warnings: Warnings

    def list_parts(self, cluster: Cluster | None) -> Sequence[Part]:
        """Return what it would deploy; nothing is written."""
        parts: Sequence[Part] = self.type.parts(self.options, self.context, cluster)
        return parts


def job_of(
    settings: Settings, name: str | None, data: Mapping[str, Any] | None = None
) -> TargetJob:
    """Return the named job, or the one that deploys the Rigelfile's application.

    Args:
        data: what a sequence passes to the job.

    Raises:
        UserError: the job does not exist, or there are several releases and no name; lists them.
        ProblemsError: the job's options are wrong, or wait for data of other jobs.
    """
    rigelfile = load(settings)
    job = Jobs(rigelfile, settings).choose(name)
    values = Values(rigelfile)
    findings = values.preview(job, data or {}).findings
    if any(finding.severity == "error" for finding in findings):
        raise grammar.problems_error(rigelfile.source, findings)
    try:
        ready = values.realise(job, data or {})
    except ProblemsError as error:  # data is missing
        error.hint = "pass what a sequence would store: --data KEY=VALUE"
        raise
    warnings = Warnings(list(ready.warnings))
    context = JobContext(
        job.name,
        rigelfile.application,
        warnings,
        settings,
        data=dict(data or {}),
        raw=ready.raw,
        place=ready.place,
        dry=True,
    )
    return TargetJob(job.type, ready.options, context, warnings)


@attrs.frozen
class Release:
    """A release on a cluster, connected.

    Attributes:
        observability: the job's options of that name; None if it was not found by a job.
    """

    cluster: Cluster
    id: ReleaseId
    observability: Any = None


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
    if settings.rigelfile == Settings().rigelfile and not settings.rigelfile.exists():
        return find_without_rigelfile(settings, name, named=named)
    jobs = read_jobs(settings)
    if name is not None and name not in jobs.rigelfile.jobs:
        return find_beside(jobs, name)
    job = jobs.choose(name, nodes)
    options = jobs.read_names(job)
    cluster = connect(settings)
    own = jobs.find_release(job, options, cluster)
    if own is None:
        raise UserError(
            f'the job "{job.name}" has no release of its own',
            hint="see the stack with `rigel observe status`, Multus with `rigel network status`",
        )
    return Release(cluster, own, getattr(options, "observability", None))


def find_without_rigelfile(settings: Settings, name: str | None, *, named: bool) -> Release:
    """Return the release with a name, or the only one of the namespace.

    Raises:
        UserError: none exists, or several do; or it must be named.
    """
    missing = f"{settings.rigelfile} does not exist, and no release is named"
    if name is None and named:
        raise UserError(missing, hint="name the release; `rigel list` lists those of a namespace")
    cluster = connect(settings)
    namespace = settings.namespace or cluster.namespace
    if name is not None:
        return Release(cluster, ReleaseId(namespace, name))
    releases = {one.release for one in list_releases(cluster, namespace)}
    if len(releases) == 1:
        return Release(cluster, releases.pop())
    there = ", ".join(sorted(one.name for one in releases))
    raise UserError(
        f"{missing}: {f'there are {there}' if there else 'none exists'} in the namespace"
        f" {namespace}",
        hint="name the release, and its namespace with -n; `rigel list -A` lists all",
    )


def find_beside(jobs: Jobs, name: str) -> Release:
    """Return the release with a name that is not a job of the Rigelfile.

    Without the right to list Secrets, as a viewer, it is not known whether it exists.

    Raises:
        UserError: the release does not exist either, or the name is nearly that of a job; or the
            kubeconfig is wrong.
        ClusterError: the cluster could not be searched for it.
    """
    unknown, close = jobs.unknown(name)
    try:
        cluster = connect(jobs.settings)
        found = Release(cluster, ReleaseId(jobs.settings.namespace or cluster.namespace, name))
        exists = bool(revisions.records(cluster, found.id))
    except RigelK8sError as error:
        if close:
            raise unknown from error
        if isinstance(error, Forbidden):
            return found
        kind = UserError if isinstance(error, UserError) else ClusterError
        raise kind(
            f'"{name}" is not a job, and a release of that name could not be looked up: '
            f"{error.message}",
            hint=error.hint,
            details=[str(unknown.hint), *error.details],
        ) from error
    if not exists:
        raise unknown
    return found

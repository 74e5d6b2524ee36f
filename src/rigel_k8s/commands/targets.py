"""Which job, and so which release, a command is about.

A release on a cluster needs no Rigelfile: its revisions have all the information.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s import rigelfile as grammar
from rigel_k8s.app.application import has_application
from rigel_k8s.app.deploying.target import release_of
from rigel_k8s.app.distros import ros_of
from rigel_k8s.app.partial import is_partial
from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.errors import ClusterError, ProblemsError, RigelK8sError, UserError
from rigel_k8s.jobs import registry
from rigel_k8s.jobs.types.orchestration import OrchestrationJob
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.pods import MASTER_NAME
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem
from rigel_k8s.release import revisions
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rigelfile.model import ComponentSpec, Rigelfile
from rigel_k8s.rigelfile.source import YamlNode
from rigel_k8s.settings import Application, Settings
from rigel_muto.agent.options import MutoAgent

NAME_NAMESPACE = "name the namespace with -n; `rigel list -A` lists all releases"
NAME_RELEASE = "name the release instead of the job; `rigel list -A` lists all releases"


@attrs.frozen
class TargetJob:
    """An orchestration job whose options are all known and right.

    Attributes:
        warnings: of its options' check, rendered.
        place: turns problems with the options into texts with their lines in the Rigelfile.
    """

    name: str
    options: Any
    raw: Mapping[str, Any]
    application: Application
    warnings: tuple[str, ...]
    place: Callable[[Sequence[Problem]], Sequence[str]] = lambda found: list(map(str, found))


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
    """Return the named orchestration job, or the one that the Rigelfile has.

    Args:
        rigelfile: the content of the settings' file, if it was read before.
        data: what a sequence passes to the job.

    Raises:
        UserError: the job does not exist, or there are several releases and no name; lists them.
        ProblemsError: the job's options are wrong, or wait for data of other jobs.
    """
    rigelfile = rigelfile or load(settings)
    spec = choose_job(rigelfile, settings, name)
    kind = OrchestrationJob.options
    try:
        made = grammar.realise(rigelfile, spec, None, data or {}, kind)
    except ProblemsError as error:
        seen = grammar.preview(rigelfile, spec, None, data or {}, kind).findings
        if all(finding.severity != "error" for finding in seen):  # only data is missing
            error.hint = "pass what a sequence would store: --data KEY=VALUE"
        raise
    application, home = rigelfile.application, settings.rigelfile.absolute().parent
    job = OrchestrationJob()
    findings = made.place_problems(
        [
            *job.check(made.options, application),
            *job.check_files(made.options, application, home),
        ]
    )
    if any(finding.severity == "error" for finding in findings):
        raise grammar.problems_error(rigelfile.source, findings)

    def render(found: Sequence[grammar.Finding]) -> tuple[str, ...]:
        return tuple(grammar.render(rigelfile.source, finding) for finding in found)

    return TargetJob(
        spec.name,
        made.options,
        made.raw,
        rigelfile.application,
        render([*made.warnings, *findings]),
        lambda problems: render(made.place_problems(problems)),
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
    agent = rigelfile.jobs.get(name or "")
    if agent is not None and is_agent(agent):
        options = names_of(rigelfile, agent, settings, MutoAgent)
        cluster = connect(settings)
        return Release(cluster, release_of(options, settings, cluster))
    try:
        options = names_of(rigelfile, choose_job(rigelfile, settings, name, nodes), settings)
    except NoSuchJob as error:
        return find_other(error, settings)
    cluster = connect(settings)
    return Release(cluster, release_of(options, settings, cluster), options.observability)


def find_only(cluster: Cluster, settings: Settings) -> Release:
    """Return the only release of the namespace. Raises UserError if there is none, or several."""
    namespace = settings.namespace or cluster.namespace
    names = sorted({one.release.name for one in list_releases(cluster, namespace)})
    if len(names) == 1:
        return name_release(cluster, settings, names[0])
    there = f"there are {', '.join(names)}" if names else "there is none"
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
    """Return the names of all orchestration jobs."""
    return [spec.name for spec in candidates(load(settings, patient=True), settings)]


def list_named(settings: Settings) -> list[str]:
    """Return the names of all jobs that `release` finds a release by."""
    rigelfile = load(settings, patient=True)
    ours = {spec.name for spec in candidates(rigelfile, settings)}
    return [name for name, spec in rigelfile.jobs.items() if name in ours or is_agent(spec)]


def node_names(settings: Settings, job: str | None = None) -> list[str]:
    """Return the keys of a job's nodes, and its other workloads. Raises as job_of."""
    rigelfile = load(settings, patient=True)
    return list_node_names(rigelfile, choose_job(rigelfile, settings, job), settings)


def list_node_names(rigelfile: Rigelfile, spec: ComponentSpec, settings: Settings) -> list[str]:
    """Return the keys of a job's nodes, and its other workloads. Raises as names_of."""
    from rigel_k8s.app.desired import deploys_master

    options = names_of(rigelfile, spec, settings)
    ros = ros_of(rigelfile.application.distro, options.ros)
    own = [str(options.deployment_name)] if has_application(options) else []
    master = [MASTER_NAME] if deploys_master(options, ros) else []
    return [*map(str, options.nodes), *own, *master]


def choose_job(
    rigelfile: Rigelfile, settings: Settings, name: str | None, nodes: Sequence[str] = ()
) -> ComponentSpec:
    """Return the meant job: deploy and update jobs of one release count as one."""
    specs = candidates(rigelfile, settings)
    if name is not None:
        return find_job(rigelfile, specs, name)
    if not specs:
        raise UserError(
            f"{rigelfile.source.name} has no orchestration job",
            hint="add a job with `plugin: rigel_k8s.OrchestrationPlugin`",
        )
    if len(specs) == 1:  # most files: its options need not be read for its names
        return specs[0]
    by_release: dict[tuple[str, str], list[ComponentSpec]] = {}
    for spec in specs:
        options = names_of(rigelfile, spec, settings)
        where = settings.namespace or str(options.namespace or "")
        by_release.setdefault((where, str(options.deployment_name)), []).append(spec)
    if len(by_release) > 1 and nodes:
        having = [
            same for same in by_release.values() if has_nodes(rigelfile, same, settings, nodes)
        ]
        if len(having) == 1:
            return choose_whole(having[0])
    if len(by_release) > 1:
        listed = ", ".join(same[0].name for same in by_release.values())
        raise UserError("the Rigelfile has several releases", hint=f"name a job, one of: {listed}")
    return choose_whole(specs)


def choose_whole(specs: Sequence[ComponentSpec]) -> ComponentSpec:
    """Return the job of a release that describes all of it, if there is one."""
    return next((spec for spec in specs if not is_partial(spec_keys(spec))), specs[0])


def has_nodes(
    rigelfile: Rigelfile, specs: Sequence[ComponentSpec], settings: Settings, nodes: Sequence[str]
) -> bool:
    """Return whether the jobs of a release have all of some nodes, by key or ROS name."""
    there = {
        object_name(key) for spec in specs for key in list_node_names(rigelfile, spec, settings)
    }
    return there.issuperset(map(object_name, nodes))


def candidates(rigelfile: Rigelfile, settings: Settings) -> list[ComponentSpec]:
    """Return all orchestration jobs."""
    directory = settings.rigelfile.absolute().parent
    return [spec for spec in rigelfile.jobs.values() if is_orchestration(spec, directory)]


def find_job(rigelfile: Rigelfile, specs: list[ComponentSpec], name: str) -> ComponentSpec:
    """Return the job of that name."""
    ours = {spec.name: spec for spec in specs}
    if name in ours:
        return ours[name]
    hint = f"orchestration jobs: {', '.join(ours) or 'none'}"
    if name in rigelfile.jobs:
        raise UserError(f'the job "{name}" is not an orchestration job', hint=hint)
    raise NoSuchJob(name, grammar.find_nearest(name, ours), hint=hint)


def is_orchestration(spec: ComponentSpec, directory: Path) -> bool:
    """Return whether a job's type is ours; an unknown one counts as another's."""
    try:
        found = registry.job_type(spec.plugin, directory)
    except UserError:
        return False
    return isinstance(found, OrchestrationJob)


def is_agent(spec: ComponentSpec) -> bool:
    """Return whether a job deploys Muto's agent, which is a release of its own."""
    return spec.plugin in ("muto-agent", "rigel_k8s.MutoAgentPlugin")


def spec_keys(spec: ComponentSpec) -> Mapping[str, Any]:
    """Return a job's `with` as far as it is in the file."""
    plain: dict[str, Any] = grammar.strip_places(spec.options)
    return plain


def names_of(
    rigelfile: Rigelfile,
    spec: ComponentSpec,
    settings: Settings,
    kind: type[Any] = OrchestrationJob.options,
    *,
    overrides: YamlNode | None = None,
    data: Mapping[str, Any] | None = None,
) -> Any:
    """Return a job's options as far as they are known without a run, and the release's names.

    The settings' namespace replaces the job's, which then need not be known.

    Args:
        kind: the class of its options.
        overrides: what a sequence lays over them.
        data: what a sequence's matrix passes to them.

    Raises:
        ProblemsError: something is wrong with them, or a name waits for data of a sequence.
    """
    seen = grammar.preview(rigelfile, spec, overrides, data or {}, kind)
    if any(finding.severity == "error" for finding in seen.findings):
        raise grammar.problems_error(rigelfile.source, seen.findings)
    options = seen.options if seen.options is not None else seen.draft
    hint = None
    if has_template(str(options.deployment_name)):
        hint = NAME_RELEASE
    elif not settings.namespace and has_template(str(options.namespace)):
        hint = NAME_NAMESPACE
    if hint:
        try:
            grammar.realise(rigelfile, spec, overrides, data or {}, kind)
        except ProblemsError as error:
            error.hint = hint
            raise
    return options

"""From an orchestration job's options to the release: everything before the first write.

`run`, `render` and `diff` share it; it only reads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import attrs

from rigel_gate.program import program
from rigel_inpod import scripts
from rigel_k8s.app.checks.application import check
from rigel_k8s.app.deploying.architectures import find_unfit_machines
from rigel_k8s.app.deploying.digests import pins
from rigel_k8s.app.deploying.parameterfiles import read_parameter_files
from rigel_k8s.app.deploying.secrets import choose_credentials, has_pull_secret, secret_name
from rigel_k8s.app.deploying.target import release_of
from rigel_k8s.app.desired import draft, has_workloads
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.partial import flat, is_partial, overlay
from rigel_k8s.errors import UserError
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.objects.podoptions import Readiness
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.observability.request import StackRequest, request_of
from rigel_k8s.release.types import Desired, ReleaseId, Revision
from rigel_k8s.rigelfile.structure import InvalidOptions, structure_plain
from rigel_k8s.settings import Application, Settings

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.problems import Problem


@attrs.frozen
class Preparation:
    """A release that is ready to be deployed.

    Attributes:
        options: the job's, merged into those of the last revision if it is a partial job.
        credentials: users of the registries that its images come from.
        findings: of the preflight; None: it has not run yet.
        stack: the job's observability stack; None: it requests none.
    """

    desired: Desired
    options: OrchestrationOptions
    credentials: tuple[RegistryCredentials, ...] = ()
    findings: Sequence[Problem] | None = None
    stack: StackRequest | None = None


def prepare(
    options: OrchestrationOptions,
    raw: Mapping[str, Any],
    application: Application,
    settings: Settings,
    cluster: Cluster | None = None,
    *,
    data: Mapping[str, Any] | None = None,
    providers: Mapping[str, Any] | None = None,
    preflight: bool = False,
) -> Preparation:
    """Return the release to deploy, with images pinned by digest where one is known.

    Args:
        raw: the job's `with` as plain data.
        cluster: read for the last revision; None: use only the Rigelfile and the registries.
        data: the sequence's shared data, with the digests of images that it pushed.
        providers: the connected providers; those of registries give credentials. None: they are
            not connected (`diff`), so a pull secret that the cluster has is kept.
        preflight: also check the network, while the registries are asked.

    Raises:
        UserError: options that contradict the last revision's, or a parameter file that is missing.
    """
    if options.observability_only:
        raise UserError(
            "observability_only: this job describes no application",
            hint="deploy one with a job without observability_only",
        )
    release = release_of(options, settings, cluster)
    last = _LastRevision(cluster, release)
    if is_partial(raw):
        options, raw = _lay_over(options, raw, last, application)
    if not has_workloads(options):
        raise UserError(
            f"nothing to deploy as {release.name} in {release.namespace}: this job describes a part"
            " of a release, which does not exist yet",
            hint="run the job that describes all of it first: application_image, or nodes",
        )
    known = [one for one in (providers or {}).values() if isinstance(one, RegistryCredentials)]
    believed = providers is None and cluster is not None and has_pull_secret(release, cluster)
    eyes = cluster if preflight and is_settled(options) else None
    prepared = _finish(
        *(options, raw, application, release, last, data or {}, known, eyes),
        home=settings.rigelfile.absolute().parent,
        secret_is_there=believed,
    )
    if cluster is None:
        return prepared
    inspect = partial(find_unfit_machines, cluster=cluster, known=known)
    return attrs.evolve(prepared, desired=attrs.evolve(prepared.desired, inspect=inspect))


def is_settled(options: OrchestrationOptions) -> bool:
    """Whether this job leaves the cluster's network as it is, without installing anything."""
    network = options.network
    return network is not None and network.install is None


def _finish(
    options: OrchestrationOptions,
    raw: Mapping[str, Any],
    application: Application,
    release: ReleaseId,
    last: _LastRevision,
    data: Mapping[str, Any],
    known: Sequence[RegistryCredentials],
    eyes: Cluster | None,
    *,
    home: Path,
    secret_is_there: bool,
) -> Preparation:
    texts, files = scripts(), read_parameter_files(options, application.dir, home)
    network = options.network
    previous = last.objects() if network and network.ipam == "static" else ()
    drafted = draft(
        options, release, application, texts, files=files, program=program(), previous=previous
    )
    credentials = choose_credentials(drafted.images, known)
    with ThreadPoolExecutor(max_workers=1) as beside:
        findings = beside.submit(_examine, drafted.objects, options, eyes)
        digests = pins(drafted.images, data, known, last.objects)
    desired = drafted.finish(
        raw=raw,
        digests=digests,
        pull_secrets=[secret_name(release.name)] if credentials or secret_is_there else [],
        create_namespace=options.namespace == release.namespace,
    )
    stack = None
    if options.observability.enabled:
        stack = request_of(flat(raw).get("observability") or {})
    return Preparation(desired, options, credentials, findings.result(), stack)


def _examine(
    objects: Sequence[Manifest], options: OrchestrationOptions, cluster: Cluster | None
) -> Sequence[Problem] | None:
    """Return what the preflight finds; None if it should not run."""
    if cluster is None:
        return None
    from rigel_k8s.network.preflight.examine import examine

    return examine(objects, options.network, cluster)


class _LastRevision:
    """The release's last good revision, read once and only if it is needed."""

    def __init__(self, cluster: Cluster | None, release: ReleaseId) -> None:
        self._cluster, self._release = cluster, release
        self._found: Revision | None = None
        self._asked = cluster is None

    @property
    def revision(self) -> Revision | None:
        if not self._asked and self._cluster is not None:
            from rigel_k8s.release.deploy import find_last_good

            self._found = find_last_good(self._cluster, self._release)
            self._asked = True
        return self._found

    def objects(self) -> tuple[Mapping[str, Any], ...]:
        return self.revision.objects if self.revision else ()


def timeout_of(options: OrchestrationOptions, settings: Settings) -> float | None:
    """Return how long the roll-out may take, in seconds; None: deploy's own default.

    In src.plugin, readiness.timeout_seconds bounds the wait for the application, so it does here;
    that of one node among others only extends the default.
    """
    if settings.timeout is not None:
        return settings.timeout
    if options.timeout is not None:
        return options.timeout.seconds
    if isinstance(options.readiness, Readiness) and options.readiness.timeout_seconds:
        return float(options.readiness.timeout_seconds)
    return _find_longest_timeout(options)


def _find_longest_timeout(options: OrchestrationOptions) -> float | None:
    from rigel_k8s.release.types import DEFAULT_TIMEOUT

    checks = [n.readiness for n in options.nodes.values() if isinstance(n.readiness, Readiness)]
    longest = max((float(c.timeout_seconds or 0) for c in checks), default=0.0)
    return longest if longest > DEFAULT_TIMEOUT else None


def _lay_over(
    options: OrchestrationOptions,
    raw: Mapping[str, Any],
    last: _LastRevision,
    application: Application,
) -> tuple[OrchestrationOptions, Mapping[str, Any]]:
    """Return a partial job's options merged into those of the last revision."""
    if last.revision is None or not last.revision.options:
        return options, raw
    merged = overlay(last.revision.options, raw)
    try:
        whole = structure_plain(
            merged, OrchestrationOptions, lambda made: check(made, application.distro)
        )
    except InvalidOptions as error:
        raise UserError(
            f"this job describes a part of revision {last.revision.number}, but does not fit it",
            hint="run the job that describes all of the release",
            details=list(map(str, error.problems)),
        ) from error
    return whole, merged

"""From an orchestration job's options to the release: everything before the first write.

`run`, `render` and `diff` share it; it only reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs

from rigel_inpod import scripts
from rigel_k8s.app.application import flat, is_partial, overlay
from rigel_k8s.app.checks.application import check
from rigel_k8s.app.deploying.images import (
    Images,
    choose_credentials,
    has_pull_secret,
    pin,
    secret_name,
)
from rigel_k8s.app.deploying.localfiles import read_files
from rigel_k8s.app.deploying.parameterfiles import read_parameter_files
from rigel_k8s.app.deploying.target import release_of
from rigel_k8s.app.desired import draft
from rigel_k8s.app.generation import Texts, generation_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.testing import choose_nodes
from rigel_k8s.app.workloads import has_workloads
from rigel_k8s.errors import UserError
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.objects.podoptions import Readiness
from rigel_k8s.release.types import DEFAULT_TIMEOUT, Desired, ReleaseId, Revision
from rigel_k8s.rigelfile.structure import InvalidOptions, structure_plain
from rigel_k8s.settings import Application, Settings
from rigel_rmw import libraries

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster


@attrs.frozen(kw_only=True)
class Request:
    """What a job asks to deploy.

    Attributes:
        options: the job's; raw: its `with` as plain data.
        data: the sequence's shared data, with the digests of images that it pushed.
        providers: the connected providers; those of registries give credentials. None: they are
            not connected (`diff`), so a pull secret that the cluster has is kept.
    """

    options: OrchestrationOptions
    raw: Mapping[str, Any]
    application: Application
    settings: Settings
    data: Mapping[str, Any] = attrs.field(factory=dict)
    providers: Mapping[str, Any] | None = None

    def choose_nodes(self) -> Request:
        """Return it without nodes of `kind: test`, unless they are to be tested."""
        options, raw = choose_nodes(self.options, self.raw, tests=self.settings.tests)
        return attrs.evolve(self, options=options, raw=raw)

    def lay_over(self, last: Revision | None) -> Request:
        """Return a partial job's request with its options merged into those of a revision."""
        if last is None or not last.options:
            return self
        merged = overlay(last.options, self.raw)
        try:
            whole = structure_plain(
                merged, OrchestrationOptions, lambda made: check(made, self.application.distro)
            )
        except InvalidOptions as error:
            raise UserError(
                f"this job describes a part of revision {last.number}, but does not fit it",
                hint="run the job that describes all of the release",
                details=list(map(str, error.problems)),
            ) from error
        return attrs.evolve(self, options=whole, raw=merged)


@attrs.frozen
class Preparation:
    """A release that is ready to be deployed.

    Attributes:
        options: the job's, merged into those of the last revision if it is a partial job.
        raw: those that are set, as plain data.
        credentials: users of the registries that its images come from.
    """

    desired: Desired
    options: OrchestrationOptions
    raw: Mapping[str, Any]
    credentials: tuple[RegistryCredentials, ...] = ()


def prepare(request: Request, cluster: Cluster | None = None) -> Preparation:
    """Return the release to deploy, with images pinned by digest where one is known.

    Args:
        cluster: read for the last revision; None: use only the Rigelfile and the registries.

    Raises:
        UserError: options that contradict the last revision's, or a file that is missing.
    """
    request = request.choose_nodes()
    release = release_of(request.options, request.settings, cluster)
    last = LastRevision(cluster, release)
    if is_partial(request.raw):
        request = request.lay_over(last.revision)
    options = request.options
    if not has_workloads(options):
        raise UserError(
            f"nothing to deploy as {release.name} in {release.namespace}: this job describes a part"
            " of a release, which does not exist yet",
            hint="run the job that describes all of it first: application_image, or nodes",
        )
    home = request.settings.rigelfile.absolute().parent
    network = options.network
    drafted = draft(
        options,
        release,
        request.application,
        Texts(
            scripts(),
            read_parameter_files(options, request.application.dir, home),
            generation_of(request.application.distro, options.ros).read_program(),
            libraries(),
            read_files(options, request.application.dir, home),
        ),
        previous=last.objects() if network and network.ipam == "static" else (),
    )
    known = [
        one for one in (request.providers or {}).values() if isinstance(one, RegistryCredentials)
    ]
    credentials = choose_credentials(drafted.images, known)
    has_secret = bool(credentials)
    if request.providers is None and cluster is not None:
        has_secret = has_pull_secret(release, cluster)
    pinned = pin(drafted.images, request.data, known, last.objects)
    desired = drafted.finish(
        raw=request.raw,
        digests=pinned.by_digest,
        pull_secrets=[secret_name(release.name)] if has_secret else [],
        create_namespace=options.namespace == release.namespace,
    )
    if cluster is not None:
        images = Images(cluster, known, pinned.unknown)
        desired = attrs.evolve(desired, inspect=images.find_obstacles)
    return Preparation(desired, options, flat(request.raw), credentials)


class LastRevision:
    """The release's last good revision, read once and only if it is needed."""

    def __init__(self, cluster: Cluster | None, release: ReleaseId) -> None:
        self._cluster, self._release = cluster, release

    @cached_property
    def revision(self) -> Revision | None:
        """The revision; None without one."""
        if self._cluster is None:
            return None
        from rigel_k8s.release.revisions import find_last_good

        return find_last_good(self._cluster, self._release)

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
    checks = [n.readiness for n in options.nodes.values() if isinstance(n.readiness, Readiness)]
    longest = max((float(c.timeout_seconds or 0) for c in checks), default=0.0)
    return longest if longest > DEFAULT_TIMEOUT else None

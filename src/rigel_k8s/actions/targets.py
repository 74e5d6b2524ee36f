"""Which job, and so which release, a command is about."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s import rigelfile as grammar
from rigel_k8s.actions.rigelfiles import load
from rigel_k8s.deploy.types import ReleaseId
from rigel_k8s.errors import UserError
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.plugins.orchestration import OrchestrationJob, is_partial, release_of
from rigel_k8s.rigelfile.model import ComponentSpec, Rigelfile
from rigel_k8s.sequences import registry
from rigel_k8s.settings import Application, Settings

__all__ = ["Release", "Target", "release", "target"]


@attrs.frozen
class Target:
    """An orchestration job with its options, as far as they are known without a run."""

    job: str
    options: Any
    raw: Mapping[str, Any]
    application: Application
    settings: Settings


@attrs.frozen
class Release:
    """A release on a cluster."""

    cluster: Cluster
    id: ReleaseId
    target: Target


def target(settings: Settings, job: str | None) -> Target:
    """Return the named orchestration job, or the one that the Rigelfile has.

    Raises:
        UserError: there is none, or several releases and no name; they are listed.
        ProblemsError: the job's options are wrong.
    """
    rigelfile = load(settings)
    targets = [realised(rigelfile, spec, settings) for spec in candidates(rigelfile, job)]
    full = [t for t in targets if not is_partial(t.raw)] or targets
    names = {(t.options.namespace, t.options.deployment_name) for t in full}
    if len(names) > 1:
        listed = ", ".join(t.job for t in full)
        raise UserError(f"the Rigelfile has several releases: name a job of {listed}")
    return full[0]


def candidates(rigelfile: Rigelfile, job: str | None) -> list[ComponentSpec]:
    """Return the orchestration jobs that may be meant."""
    ours = {n: s for n, s in rigelfile.jobs.items() if is_orchestration(rigelfile, s)}
    if job is None:
        if not ours:
            raise UserError(
                f"{rigelfile.source.name} has no orchestration job",
                hint="a job with `plugin: rigel_k8s.OrchestrationPlugin` deploys an application",
            )
        return list(ours.values())
    if job in ours:
        return [ours[job]]
    if job in rigelfile.jobs:
        raise UserError(f'the job "{job}" deploys nothing', hint=f"jobs that do: {', '.join(ours)}")
    close = grammar.nearest(job, ours)
    meant = f', did you mean "{close}"?' if close else ""
    raise UserError(f'there is no job "{job}"{meant}', hint=f"jobs that deploy: {', '.join(ours)}")


def is_orchestration(rigelfile: Rigelfile, spec: ComponentSpec) -> bool:
    """Return whether a job's type is ours; an unknown one is somebody else's."""
    try:
        found = registry.job_type(spec.plugin, rigelfile.application.dir)
    except UserError:
        return False
    return isinstance(found, OrchestrationJob)


def realised(rigelfile: Rigelfile, spec: ComponentSpec, settings: Settings) -> Target:
    """Return a job with its options; data of earlier jobs is not known here."""
    result = grammar.realise(rigelfile, spec, None, {}, OrchestrationJob.options)
    return Target(spec.name, result.options, result.raw, rigelfile.application, settings)


def release(settings: Settings, job: str | None = None) -> Release:
    """Return the release of a job, connected."""
    found = target(settings, job)
    cluster = connect(settings)
    return Release(cluster, release_of(found.options, settings, cluster), found)

"""The observability stack as `render` and `diff` show it: what a job would deploy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s import rigelfile as grammar
from rigel_k8s.commands.targets import TargetJob
from rigel_k8s.errors import UserError
from rigel_k8s.jobs import registry
from rigel_k8s.jobs.types.observability import ObservabilityJob
from rigel_k8s.kube import Cluster
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.observability.desired import desired_stack, render_stack
from rigel_k8s.observability.request import StackRequest
from rigel_k8s.release import deploy as deploys
from rigel_k8s.release.labelling import manifests_to_apply
from rigel_k8s.release.types import Plan
from rigel_k8s.rigelfile.model import Rigelfile
from rigel_k8s.settings import Settings


def stack_job(
    rigelfile: Rigelfile, settings: Settings, name: str | None, data: Mapping[str, Any] | None
) -> TargetJob | None:
    """Return the named job if it deploys only the stack, else None.

    Args:
        data: what a sequence passes to the job.

    Raises:
        ProblemsError: its options are wrong, or wait for data of other jobs.
    """
    spec = rigelfile.jobs.get(name) if name else None
    if spec is None:
        return None
    try:
        found = registry.job_type(spec.plugin, settings.rigelfile.absolute().parent)
    except UserError:
        return None
    if not isinstance(found, ObservabilityJob):
        return None
    made = grammar.realise(rigelfile, spec, None, data or {}, ObservabilityJob.options)
    findings = made.place_problems(found.check(made.options, rigelfile.application))
    if any(finding.severity == "error" for finding in findings):
        raise grammar.problems_error(rigelfile.source, findings)
    warnings = tuple(grammar.render(rigelfile.source, finding) for finding in findings)
    return TargetJob(spec.name, made.options, made.raw, rigelfile.application, warnings)


def manifests(request: StackRequest) -> tuple[Manifest, ...]:
    """Return the stack's manifests as one job describes it, without a cluster."""
    return manifests_to_apply(render_stack(request).desired)


def plan(request: StackRequest, cluster: Cluster, *, adopt: bool) -> Plan:
    """Return what a job would change in the existing stack. Raises like a deploy."""
    return deploys.diff(desired_stack(request, cluster).desired, cluster, adopt=adopt)

"""A look at the cluster before a deploy: what is there, what would be done, and why not."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence

import attrs

from rigel_k8s.errors import ClusterError, Interrupted, RigelK8sError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.release import revisions
from rigel_k8s.release.drift import describe_drift
from rigel_k8s.release.part import Look, Part, Run, order, warn_of_rights
from rigel_k8s.release.plan import compare
from rigel_k8s.release.refusals import verdict
from rigel_k8s.release.survey import Survey, survey
from rigel_k8s.release.types import DeployOptions, Plan, Revision

ATTEMPTS = 3  # looks at the cluster when other deploys end while we wait for the Lease


def look(parts: Iterable[Part], cluster: Cluster, options: DeployOptions) -> list[Look]:
    """Return what would be done for each part, in order; nothing is written.

    Raises:
        RigelK8sError: all reasons for which any would be refused, in one error.
    """
    errors: list[RigelK8sError] = []
    looks: list[Look] = []
    for part in order(parts):
        try:
            adopt = options.adopt and part.adopt
            looks.append(look_at(part, cluster, adopt=adopt, earlier=looks))
        except Forbidden as error:
            if error.ground != "right" or part.own:
                errors.append(error)
            else:
                warn_of_rights(error, part.release.name, options.report)
        except Interrupted:
            raise
        except (UserError, ClusterError) as error:
            errors.append(error)
    if errors:
        raise combine(errors)
    return looks


def look_at(part: Part, cluster: Cluster, *, adopt: bool, earlier: Sequence[Look] = ()) -> Look:
    """Return what would be done for one part.

    Args:
        adopt: take over objects and fields of others.
        earlier: what will be written before.

    Raises:
        RigelK8sError: all reasons for which it would be refused, in one error.
    """
    part.desired = attrs.evolve(part.desired, defined=frozenset(list_defined(earlier)))
    looked, inspection = cluster.gather(
        lambda: compare_part(part, cluster, adopt=adopt),
        lambda: part.hooks.inspect(cluster, earlier),
    )
    if isinstance(looked, RigelK8sError):
        raise combine([looked, *inspection.errors])
    if inspection.errors:
        raise combine(inspection.errors)
    drift = [] if adopt else list_drift(looked.plan)
    return attrs.evolve(looked, warnings=(*inspection.warnings, *drift))


def compare_part(part: Part, cluster: Cluster, *, adopt: bool) -> Look | RigelK8sError:
    """Return what would be done to its objects, or why that would be refused."""
    if part.foreign:
        return Look(part, None, Plan(part.release, ()))
    try:
        return refuse_or_plan(part, cluster, adopt=adopt)
    except Forbidden as error:
        if error.ground == "right" and part.hint:
            error.hint = part.hint
        return error
    except verdict.Refused as refused:
        refused.details = tuple(part.place(refused.problems))
        return refused
    except Interrupted:
        raise
    except (UserError, ClusterError) as error:
        return error


def refuse_or_plan(part: Part, cluster: Cluster, *, adopt: bool) -> Look:
    """Return what would be done to its objects. Raises as verdict.check."""
    found = survey(cluster, part.desired, adopt=adopt)
    verdict.check(found, adopt=adopt)
    plan = compare(found, keep=part.keep)
    return Look(part, found, plan, find_settled(found, plan))


def find_settled(found: Survey, plan: Plan) -> Revision | None:
    """Return the last revision, if it is good and as desired, and the cluster matches it.

    The revisions may have been read before another deploy began, and the objects after it wrote
    them: so the last revision's objects are compared as well.
    """
    last = found.last
    if last is None or last.status != "good" or plan.changes:
        return None
    wanted = (revisions.choose_recordable(found.manifests), found.desired.options)
    before, now = (
        json.dumps(both, sort_keys=True) for both in ((last.objects, last.options), wanted)
    )
    return last if before == now else None


def look_again(run: Run, seen: Look) -> Look:
    """Return what was seen; look again if another deploy has ended since."""
    for _ in range(ATTEMPTS):
        newest = revisions.records(run.cluster, run.release)
        if revisions.versions(newest) == revisions.versions(seen.survey.history):
            return seen
        seen = refuse_or_plan(run.part, run.cluster, adopt=run.options.adopt)
    return seen


def list_defined(looks: Iterable[Look]) -> Iterator[tuple[str, str]]:
    """Yield the kinds that some parts define, each with its group."""
    for manifest in (item for one in looks for item in one.part.desired.objects):
        if manifest["kind"] == "CustomResourceDefinition":
            yield manifest["spec"]["group"], manifest["spec"]["names"]["kind"]


def list_drift(plan: Plan) -> list[str]:
    """Return what others have added to a release's objects, which a deploy leaves there."""
    return [
        f"{step.ref.kind} {step.ref.name} {text}; --adopt undoes it"
        for step in plan.steps
        if step.live and step.manifest
        for text in describe_drift(step.live)
    ]


def combine(errors: Iterable[RigelK8sError]) -> RigelK8sError:
    """Return one error for several, each of them once."""
    several = list({error.message: error for error in errors}.values())
    if len(several) == 1:
        return several[0]
    kind = UserError if any(isinstance(one, UserError) for one in several) else ClusterError
    details = []
    for one in several:
        details += [one.message, *(f"    {line}" for line in (*one.details, one.hint) if line)]
    return kind(
        f"{len(several)} things keep this job from being deployed; nothing was changed",
        details=details,
    )

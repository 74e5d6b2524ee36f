"""What keeps a release's pods from being made, as problems with their places; pure.

Workloads that are refused for the same reason share a problem: a namespace that takes no root user
refuses every node of an application with the same words.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from decimal import Decimal

from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.marks import SINGLETON_ANNOTATION
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.problems import Problem
from rigel_k8s.release.refusals import quotas
from rigel_k8s.release.refusals.quotas import Change
from rigel_k8s.release.refusals.rights import find_resource
from rigel_k8s.release.refusals.trials import find_template
from rigel_k8s.release.revisions import secret_ref
from rigel_k8s.release.survey import Survey

SHOWN = 3  # names of workloads in a message; the rest is counted
#: How a refusal calls the pod that was tried; its name is made by the dry run.
POD = re.compile(r'^pods "[^"]*" is forbidden: ')


def find_refused_pods(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each reason for which the cluster refuses pods.

    That a quota is exceeded is computed from all pods (`find_exceeded`); a single pod's dry run
    does not know that others end before it starts. Its word counts where nothing ends.
    """
    exceeded = {ref for excess in find_excess(survey) for ref in excess.refs}
    ends = any(ref.kind in ("Deployment", "Pod") for ref in survey.live)
    reasons: dict[tuple[str, str], list[ObjectRef]] = {}
    for ref, answer in survey.foreseen.pods.items():
        if not isinstance(answer, Refusal):
            continue
        ground = str(answer.ground) if isinstance(answer, Forbidden) else "other"
        if ground == "quota" and (ends or ref in exceeded):
            continue
        reasons.setdefault((ground, describe_reason(answer, ref)), []).append(ref)
    for (ground, reason), refs in reasons.items():
        yield make_problem(survey, refs, f"the cluster refuses its pods: {reason}", ground)


def find_unfit(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each workload that no machine can run."""
    for ref, reason in survey.foreseen.unfit.items():
        yield make_problem(survey, [ref], reason, "architecture")


def describe_reason(error: Refusal, ref: ObjectRef) -> str:
    """Return Kubernetes' reason without the name of what was tried."""
    causes = [f"{cause.field}: {cause.message}" for cause in error.causes if cause.field]
    text = "; ".join(causes) or POD.sub("", error.words) or error.message
    return text.replace(f'"{ref.name}"', "NAME")


def find_exceeded(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each quota that the release does not fit into."""
    for excess in find_excess(survey):
        text = (
            f"the quota {excess.quota} does not suffice: {excess.added} more of {excess.resource},"
            f" of which {excess.used} of {excess.hard} are used"
        )
        yield make_problem(survey, excess.refs, text, "quota")


def find_excess(survey: Survey) -> Iterator[quotas.Excess]:
    """Yield the quotas that the release exceeds."""
    if survey.foreseen.quotas:
        yield from quotas.find_excess(survey.foreseen.quotas, list(list_changes(survey)))


def make_problem(survey: Survey, refs: Sequence[ObjectRef], text: str, ground: str) -> Problem:
    """Return a problem at the place of the first workload, with the way out that is known."""
    remedy = survey.desired.remedies.get(ground, "")
    message = f"{name_all(refs)}: {text}" + (f"; {remedy}" if remedy else "")
    path = survey.desired.origins.get(refs[0], ()) if refs else ()
    return Problem(path, message, ground if ground != "other" else "refused")


def name_all(refs: Sequence[ObjectRef]) -> str:
    """Return the names of workloads, the first few of them."""
    if not refs:
        return "the release"
    rest = len(refs) - SHOWN
    shown = [str(refs[0]), *(ref.name for ref in refs[1:SHOWN])]
    return ", ".join(shown) + (f" and {rest} more" if rest > 0 else "")


def list_changes(survey: Survey) -> Iterator[Change]:
    """Yield what the deploy does to quotas: pods, objects and its own record."""
    manifests = {ref_of(manifest): manifest for manifest in survey.manifests}
    for ref in survey.results:
        live = survey.live.get(ref)
        manifest = manifests[ref]
        if live is None:
            yield count_object(ref, manifest)
        if manifest["kind"] == "Deployment":
            yield count_workload(survey, ref, manifest, live)
    for ref in list_records(survey):
        yield count_object(ref, {"apiVersion": ref.api_version, "kind": ref.kind})


def list_records(survey: Survey) -> Iterator[ObjectRef]:
    """Yield what a deploy writes for itself: the revision, and the Lease while it lasts."""
    release = survey.desired.release
    yield secret_ref(release, survey.next_number)
    yield ObjectRef("coordination.k8s.io/v1", "Lease", release.namespace, f"rigel.{release.name}")


def count_object(ref: ObjectRef, manifest: Manifest) -> Change:
    """Return what a new object takes of quotas."""
    resource = find_resource(ref.api_version, ref.kind)
    return Change(ref, quotas.amounts_of_object(manifest, resource.plural) if resource else {})


def count_workload(
    survey: Survey, ref: ObjectRef, manifest: Manifest, live: Manifest | None
) -> Change:
    """Return what the pods of a created or changed Deployment take of quotas, and give back."""
    answer = survey.foreseen.pods.get(ref)
    pod = None if answer is None or isinstance(answer, Refusal) else answer
    added = quotas.amounts_of_workload(manifest, pod)
    if live is None:
        return Change(ref, added, sum_up(find_predecessors(survey, manifest)))
    overlap = {}
    if answer is not None and quotas.makes_new_pod_first(manifest):
        overlap = quotas.amounts_of_pod(live["spec"]["template"])
    return Change(ref, added, quotas.amounts_of_workload(live), overlap)


def find_predecessors(survey: Survey, manifest: Manifest) -> Iterator[Manifest]:
    """Yield the live workloads that end before a new one starts: those of the same identity."""
    wanted = {ref_of(one) for one in survey.manifests}
    identity = read_identity(manifest)
    for ref, live in survey.live.items():
        same = identity and read_identity(live) == identity
        if same and ref not in wanted and find_template(live) is not None:
            yield live


def read_identity(manifest: Manifest) -> str:
    """Return the identity that only one workload may have at a time, "" for none."""
    return str((manifest["metadata"].get("annotations") or {}).get(SINGLETON_ANNOTATION, ""))


def sum_up(workloads: Iterable[Manifest]) -> dict[str, Decimal]:
    """Return what some workloads' pods take together."""
    total: dict[str, Decimal] = {}
    for workload in workloads:
        quotas.add(total, quotas.amounts_of_workload(workload))
    return total

"""What a deploy takes of its namespace's quotas: pods, objects, its own record; pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from decimal import Decimal

from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.lease import lease_ref
from rigel_k8s.release.plan import singleton
from rigel_k8s.release.refusals import quotas
from rigel_k8s.release.refusals.quotas import Change
from rigel_k8s.release.refusals.rights import find_resource
from rigel_k8s.release.refusals.trials import find_template
from rigel_k8s.release.revisions import secret_ref
from rigel_k8s.release.survey import Survey


def list_excesses(survey: Survey) -> Iterator[quotas.Excess]:
    """Yield the quotas that the release exceeds."""
    if survey.foreseen.quotas:
        yield from quotas.find_excess(survey.foreseen.quotas, list(list_changes(survey)))


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
    """Yield what a deploy writes for itself: the revision, and the Lease while it runs."""
    release = survey.desired.release
    yield secret_ref(release, survey.next_number)
    yield lease_ref(release)


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
    identity = singleton(manifest)
    for ref, live in survey.live.items():
        same = identity and singleton(live) == identity
        if same and ref not in wanted and find_template(live) is not None:
            yield live


def sum_up(workloads: Iterable[Manifest]) -> dict[str, Decimal]:
    """Return what some workloads' pods take together."""
    total: dict[str, Decimal] = {}
    for workload in workloads:
        quotas.add(total, quotas.amounts_of_workload(workload))
    return total

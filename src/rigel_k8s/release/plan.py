"""What a deploy will do, from what is desired and what exists; pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.facts import is_met
from rigel_k8s.objects.marks import SINGLETON_ANNOTATION
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.survey import Live, Survey, belongs, describe_namespace, is_unchanged
from rigel_k8s.release.types import PROTECTED, WORKLOADS, InventoryItem, Plan, ReleaseId, Step, rank

if TYPE_CHECKING:
    from rigel_k8s.release.part import Part

#: What changes without us, and what does not describe the object.
NOISE = ("managedFields", "resourceVersion", "generation", "uid", "creationTimestamp", "selfLink")


def compare(survey: Survey, *, keep: Collection[ObjectRef] = ()) -> Plan:
    """Return the steps of a deploy, in the order of apply; prunes come last.

    Args:
        keep: objects that stay even without a manifest (a rollback's Secrets).
    """
    steps = [step_of(manifest, survey) for manifest in survey.manifests]
    if survey.namespace is None and survey.desired.create_namespace:
        namespace = describe_namespace(survey.desired.release.namespace)
        steps.insert(0, Step("create", ref_of(namespace), namespace, result=namespace))
    wanted = {step.ref for step in steps}
    steps += [Step("keep", ref, live=survey.live.get(ref)) for ref in keep if ref in survey.live]
    gone = [i for i in survey.inventory if i.ref not in wanted and i.ref not in keep]
    steps += prunes(gone, survey.live, survey.desired.protected, survey.desired.release)
    return Plan(survey.desired.release, tuple(steps))


def step_of(manifest: Manifest, survey: Survey) -> Step:
    """Return the step for one manifest; a Job that has failed runs again."""
    ref = ref_of(manifest)
    live, result = survey.live.get(ref), survey.results.get(ref)
    if isinstance(result, Refusal):
        raise result  # `verdict.check` comes first and explains it
    if live is None or live["metadata"].get("deletionTimestamp"):
        return Step("create", ref, manifest, live, result or manifest)
    if result is None:
        unchanged = is_unchanged(manifest, live)
    else:
        unchanged = substance(live) == substance(result)
    if ref.kind == "Job" and is_met(live.get("status") or {}, "Failed"):
        return Step("change", ref, manifest, live, live if unchanged else result, replaces=True)
    if unchanged:
        return Step("keep", ref, manifest, live, live)
    replaces = result is not None and not result["metadata"].get("resourceVersion")
    return Step("change", ref, manifest, live, result, replaces=replaces)


def substance(live: Manifest) -> dict[str, Any]:
    """Return an object without what changes automatically."""
    meta = {k: v for k, v in live["metadata"].items() if k not in NOISE}
    return {**{k: v for k, v in live.items() if k != "status"}, "metadata": meta}


def prunes(
    items: Collection[InventoryItem],
    live: Mapping[ObjectRef, Live],
    protected: Collection[ObjectRef],
    release: ReleaseId,
    *,
    volumes: bool = False,
) -> Iterator[Step]:
    """Yield what happens to objects that are no longer desired: what others need comes last.

    Args:
        volumes: whether what holds data is deleted too.
    """
    for item in sorted(items, key=lambda item: -rank(item.ref.kind)):
        found = live.get(item.ref)
        if found is None:
            continue
        ours = item.uid == found["metadata"]["uid"] or belongs(found, release)
        holds_data = item.ref.kind in PROTECTED or item.ref in protected
        if not ours or (holds_data and not volumes):
            yield Step("forget", item.ref, live=found)
        else:
            yield Step("prune", item.ref, live=found)


def predecessors(plan: Plan) -> list[Step]:
    """Return the prunes that must end before the workloads that replace them may start."""
    coming = {
        one for step in plan.steps if step.action == "create" for one in singletons(step.manifest)
    }
    return [s for s in plan.steps if s.action == "prune" and singletons(s.live) & coming]


def singletons(manifest: Manifest | None) -> set[str]:
    """Return the identities that only one workload may have at a time."""
    annotations = (manifest or {"metadata": {}})["metadata"].get("annotations") or {}
    return set(str(annotations.get(SINGLETON_ANNOTATION, "")).split())


def describe_plan(plan: Plan, part: Part, elsewhere: str) -> tuple[Sequence[str], Sequence[str]]:
    """Return what will be done as lines, and as warnings which data is left where it is.

    Args:
        part: what is deployed.
        elsewhere: the folder of another Rigelfile that made the last revision, "" for this one.
    """
    missing = (
        "no longer in the Rigelfile" if part.back_to is None else f"not in revision {part.back_to}"
    )
    words = {"create": "to create", "change": "to change", "prune": "to delete"}
    counts = [
        f"{sum(1 for step in plan.steps if step.action == action)} {word}"
        for action, word in words.items()
        if any(step.action == action for step in plan.steps)
    ]
    lines = [
        f"{plan.release.namespace}/{plan.release.name}: {', '.join(counts) or 'nothing to change'}"
    ]
    warnings = []
    if lost := [s.ref.name for s in plan.steps if s.action == "prune" and s.ref.kind in WORKLOADS]:
        text = f"{missing}, and deleted: {', '.join(lost)}"
        if elsewhere:
            warnings.append(f"{text} (deployed from {elsewhere} before)")
        else:
            lines.append(text)
    warnings += [
        f"{step.ref} is {missing}; it holds data, so it is kept "
        f"(kubectl delete {step.ref.kind.lower()} {step.ref.name} removes it)"
        for step in plan.steps
        if step.action == "forget"
    ]
    warnings += [
        f"{ref} is missing, and no revision contains it: deploy from the Rigelfile"
        for ref in sorted(set(part.keep) - {step.ref for step in plan.steps})
    ]
    return lines, warnings

"""Whether a deploy is refused before anything is applied, why, and the way out; pure.

All reasons are reported at once: objects of other releases, fields of other managers, what
Kubernetes never lets change, pods.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.errors import ConflictError, UserError
from rigel_k8s.kube.failures import Conflict, Forbidden, Missing, Refusal, StatusCause
from rigel_k8s.objects.marks import (
    FIRST_ANNOTATION,
    OPTIONAL_ANNOTATION,
    RELEASE_LABEL,
    find_development,
    is_optional,
    remedy_of,
)
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.text import plural
from rigel_k8s.problems import Problem
from rigel_k8s.release.labelling import managers
from rigel_k8s.release.refusals.foresight import OLD_STRATEGY
from rigel_k8s.release.refusals.missing import explain_missing
from rigel_k8s.release.survey import Survey, belongs, describe_owner
from rigel_k8s.release.types import WORKLOADS

ADOPT = "run it again with --adopt to take them over; they are changed to match the Rigelfile"
DELETE = "kubectl {where}delete {kind} {name}"
SELECTOR = (
    "Kubernetes never changes which pods a {kind} selects; "
    "give it another name, or delete it first: {delete}"
)
SIZE = (
    "a claim cannot go from {old} to {new}: it never shrinks, and grows only when it is bound and "
    "its storage class allows it; keep {old}, or delete it with its data first: {delete}"
)
CLAIM = (
    "it exists with {old}, the Rigelfile now has {new}, and Kubernetes cannot change that once a "
    "claim has its volume; write the old value again, give the volume another name to get an empty "
    "one, or delete the claim and its data first: {delete}"
)
VOLUME = (
    "Kubernetes never changes where a volume's data are; keep the path, give the volume another "
    "name, or delete volume and claim first (its files stay on the machine): {delete}"
)


class Refused(UserError):
    """The cluster's objects cannot be changed to what the Rigelfile describes.

    Attributes:
        problems: one for each object, with the path of the options that it came from.
    """

    problems: tuple[Problem, ...] = ()


def check(survey: Survey, *, adopt: bool) -> None:
    """Raise if a deploy cannot continue.

    Raises:
        Forbidden: rights are missing; all of them are listed.
        Refused: immutable fields, objects of another release, pods that the cluster would refuse.
        ConflictError: objects or fields of another manager, which must not be adopted.
    """
    if survey.foreseen.missing:
        raise explain_missing(survey.desired, survey.foreseen.missing)
    problems = [
        *([] if adopt else find_other_source(survey)),
        *find_foreign(survey),
        *find_invalid(survey),
        *find_refused_pods(survey),
        *explain_obstacles(survey),
    ]
    lines = [] if adopt else [*find_unowned(survey), *find_conflicts(survey)]
    if problems:
        problems += [Problem((), f"{line}; --adopt takes it over", "not-ours") for line in lines]
        error = Refused(
            f"{survey.desired.release.name} cannot be deployed; nothing was changed",
            details=[problem.message for problem in problems],
        )
        error.problems = tuple(problems)
        raise error
    if lines:
        raise ConflictError(
            f"{plural(len(lines), 'object')} of {survey.desired.release.name}"
            f" {'is' if len(lines) == 1 else 'are'} managed by others; "
            "nothing was changed",
            hint=ADOPT,
            details=lines,
        )


def find_other_source(survey: Survey) -> Iterator[Problem]:
    """Yield a problem if another Rigelfile made the release, and most of what it runs would go.

    The default name of a release is the same in every Rigelfile, and so are names of nodes.
    """
    if (last := survey.last) is None or not survey.elsewhere:
        return
    ours, theirs = list_needed(survey.manifests), list_needed(last.objects)
    lost = sorted(theirs - ours)
    if ours and 2 * len(lost) > len(theirs):
        text = (
            f"{last.release.name} was deployed from {survey.elsewhere}, and {', '.join(lost)}"
            " would be deleted: set `deployment_name` here for a release beside it, or replace it"
            " with `--adopt`"
        )
        yield Problem(("deployment_name",), text, "other-rigelfile")


def list_needed(manifests: Iterable[Manifest]) -> set[str]:
    """Return the names of workloads, without those that any application may have."""
    return {
        manifest["metadata"]["name"]
        for manifest in manifests
        if manifest["kind"] in WORKLOADS
        and not {FIRST_ANNOTATION, OPTIONAL_ANNOTATION}
        & {*(manifest["metadata"].get("annotations") or ())}
    }


def find_foreign(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each object that another release owns."""
    for ref, live in find_overwritten(survey):
        owner = describe_owner(live)
        if owner and not belongs(live, survey.desired.release):
            text = f"{ref} belongs to another release ({owner}): choose another name"
            yield Problem(survey.desired.origins.get(ref, ()), text, "other-release")


def find_unowned(survey: Survey) -> Iterator[str]:
    """Yield a line for each object that exists and that we have not made."""
    known = {item.uid for item in survey.inventory if item.uid}
    for ref, live in find_overwritten(survey):
        labels = live["metadata"].get("labels") or {}
        if RELEASE_LABEL not in labels and live["metadata"].get("uid") not in known:
            made_by = ", ".join(managers(live)) or "another program"
            yield f"{ref} already exists, made by {made_by}"


def find_conflicts(survey: Survey) -> Iterator[str]:
    """Yield a line for each object of which another manager owns fields that we want to write."""
    for ref, result in survey.results.items():
        if isinstance(result, Conflict) and result.fields:
            owners: dict[str, list[str]] = {}
            for field in result.fields:
                owners.setdefault(field.manager, []).append(field.field)
            owned = "; ".join(f"{manager} owns {', '.join(f)}" for manager, f in owners.items())
            yield f"{ref}: {owned}"


def find_overwritten(survey: Survey) -> Iterator[tuple[ObjectRef, Manifest]]:
    """Yield the objects that exist and that we are about to write."""
    for ref in survey.results:
        if ref in survey.live:
            yield ref, survey.live[ref]


def find_invalid(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each object that Kubernetes would refuse."""
    manifests = {(m["kind"], m["metadata"]["name"]): m for m in survey.manifests}
    for ref, result in survey.results.items():
        if not isinstance(result, Refusal) or (isinstance(result, Conflict) and result.fields):
            continue
        path = survey.desired.origins.get(ref, ())
        manifest = manifests[ref.kind, ref.name]
        text = explain(ref, result, survey.live.get(ref), manifest)
        kind = "unknown-kind" if isinstance(result, Missing) else "refused"
        yield Problem(path, f"{ref}: {text}", "immutable" if ref in survey.live else kind)


def explain(ref: ObjectRef, error: Refusal, live: Manifest | None, manifest: Manifest) -> str:
    """Return what a refusal means and the way out; causes without one in Kubernetes' own words."""
    where = f"-n {ref.namespace} " if ref.namespace else ""
    delete = DELETE.format(where=where, kind=ref.kind.lower(), name=ref.name)
    causes = [cause for cause in error.causes if cause.field != OLD_STRATEGY]
    words: list[str] = []
    known: list[StatusCause] = []
    if live is not None:
        known = [cause for cause in causes if "immutable" in cause.message]
        if ref.kind == "PersistentVolumeClaim":
            words = list(explain_claim(live, manifest, delete))
            known = [cause for cause in causes if cause.field.startswith("spec")]
        elif ref.kind == "PersistentVolume":
            words = [VOLUME.format(delete=delete)] if known else []
        else:
            known = [cause for cause in known if cause.field.startswith("spec.selector")]
            words = [SELECTOR.format(kind=ref.kind, delete=delete)] if known else []
    rest = [cause for cause in causes if not words or cause not in known]
    if live is not None and any("Forbidden: updates to" in cause.message for cause in rest):
        return f"{'; '.join([*words, *map(str, rest)])}; or delete it first: {delete}"
    return "; ".join([*words, *map(str, rest)]) or error.message


def explain_claim(live: Manifest, manifest: Manifest, delete: str) -> Iterator[str]:
    """Yield what is wrong with a changed claim."""
    asked: Mapping[str, Any] = manifest["spec"]
    old, new = (spec["resources"]["requests"]["storage"] for spec in (live["spec"], asked))
    if old != new:
        yield SIZE.format(old=old, new=new, delete=delete)
    names = ("storageClassName", "accessModes", "volumeName", "selector", "volumeMode")
    changed = [n for n in names if n in asked and asked[n] != live["spec"].get(n)]
    if changed:
        old, new = (
            ", ".join(f"{name} {write_value(spec.get(name))}" for name in changed)
            for spec in (live["spec"], asked)
        )
        yield CLAIM.format(old=old, new=new, delete=delete)


def write_value(value: object) -> str:
    """Return a value of a claim for people."""
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value or "(none)")


SHOWN = 3  # names of workloads in a message; the others are counted

#: How a refusal names the pod of the trial; the dry run makes its name.
POD = re.compile(r'^pods "[^"]*" is forbidden: ')


def find_refused_pods(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each reason for which the cluster refuses pods.

    That a quota is exceeded counts only if no pod ends: a dry run does not see that others end
    before the new one starts.
    """
    ends = any(ref.kind in ("Deployment", "Pod") for ref in survey.live)
    reasons: dict[tuple[str, str], list[ObjectRef]] = {}
    for ref, answer in survey.foreseen.pods.items():
        if not isinstance(answer, Refusal):
            continue
        ground = str(answer.ground) if isinstance(answer, Forbidden) else "other"
        if ground == "quota" and ends:
            continue
        reasons.setdefault((ground, describe_reason(answer, ref)), []).append(ref)
    for (ground, reason), refs in reasons.items():
        yield make_problem(survey, refs, f"the cluster refuses its pods: {reason}", ground)


def explain_obstacles(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each obstacle of what the release needs."""
    optional = {ref_of(m) for m in survey.manifests if is_optional(m)}
    shared: dict[tuple[str, str], list[ObjectRef]] = {}
    for one in survey.foreseen.obstacles:
        if one.ref not in optional:
            shared.setdefault((one.text, one.ground), []).append(one.ref)
    for (text, ground), refs in shared.items():
        yield make_problem(survey, refs, text, ground)


def warn_of_obstacles(survey: Survey) -> Iterator[str]:
    """Yield a line for each workload that will not start and that can be done without.

    Before that one for each that someone develops: the deploy ends that.
    """
    notes = {find_development(live) for live in survey.live.values()} - {""}
    yield from (f"{note}; this deploy ends that" for note in sorted(notes))
    by_name = {ref_of(m): m for m in survey.manifests}
    for one in survey.foreseen.obstacles:
        if is_optional(by_name[one.ref]):
            way_out = remedy_of(by_name[one.ref])
            text = f"{one.ref.name} will not start: {one.text}; {survey.desired.release.name} runs"
            yield f"{text} without it" + (f"; {way_out}" if way_out else "")


def describe_reason(error: Refusal, ref: ObjectRef) -> str:
    """Return Kubernetes' reason without the name of what was tried."""
    text = "; ".join(map(str, error.causes)) or POD.sub("", error.words) or error.message
    return text.replace(f'"{ref.name}"', "NAME")


def make_problem(survey: Survey, refs: Sequence[ObjectRef], text: str, ground: str) -> Problem:
    """Return a problem at the place of the first workload, with its known way out."""
    remedy = survey.desired.remedies.get(ground, "")
    message = f"{name_all(refs)}: {text}" + (f"; {remedy}" if remedy else "")
    path = survey.desired.origins.get(refs[0], ()) if refs else ()
    return Problem(path, message, ground if ground != "other" else "refused")


def name_all(refs: Sequence[ObjectRef]) -> str:
    """Return the names of workloads, or of the first few."""
    if not refs:
        return "the release"
    rest = len(refs) - SHOWN
    shown = [str(refs[0]), *(ref.name for ref in refs[1:SHOWN])]
    return ", ".join(shown) + (f" and {rest} more" if rest > 0 else "")

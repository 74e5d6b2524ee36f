"""What prevents a release's pods from being created, as problems with their places; pure.

Workloads that are refused for the same reason share a problem: a namespace that accepts no root
user refuses every node of an application with the same message.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.marks import is_optional, remedy_of
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.problems import Problem
from rigel_k8s.release.survey import Survey

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


def find_obstacles(survey: Survey) -> Iterator[Problem]:
    """Yield a problem for each obstacle of what the release needs."""
    optional = {ref_of(m) for m in survey.manifests if is_optional(m)}
    shared: dict[tuple[str, str], list[ObjectRef]] = {}
    for one in survey.foreseen.obstacles:
        if one.ref not in optional:
            shared.setdefault((one.text, one.ground), []).append(one.ref)
    for (text, ground), refs in shared.items():
        yield make_problem(survey, refs, text, ground)


def warn_of_obstacles(survey: Survey) -> Iterator[str]:
    """Yield a line for each workload that will not start and that can be done without."""
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

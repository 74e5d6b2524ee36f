"""Pulls images before pods that end first are replaced: a pull is then no part of the gap.

Kubernetes ends the old pod of a Recreate Deployment before the kubelet pulls the new image. So a
pod that does nothing but pull runs on the same machine before the first write. If its image cannot
be pulled, nothing is changed. Whatever else keeps such a pod from pulling is no reason to fail: the
update then continues without it.

Such a pod does not have the release's label, so nothing counts it as a part of the release. In case
our process is killed, it has a deadline, and Kubernetes deletes it with the Deployment.
"""

from __future__ import annotations

import json
import re
import time
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, Interrupted, UserError
from rigel_k8s.image_reference import parse_reference
from rigel_k8s.kube.failures import Conflict, Forbidden, Refusal
from rigel_k8s.objects.facts import is_ready, stays_ready
from rigel_k8s.objects.images import containers, images_of, list_loaded
from rigel_k8s.objects.marks import PULL_LABEL, RELEASE_LABEL, image_remedy_of, is_optional
from rigel_k8s.objects.overlay import mapping, pod_of
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.scheduling import may_run
from rigel_k8s.release.part import Run
from rigel_k8s.release.rollout.causes import CAUSES, START, Cause, explain_pod
from rigel_k8s.release.rollout.patience import Ledger
from rigel_k8s.release.rollout.view import EVENT, POD, ReleaseView
from rigel_k8s.release.types import Plan, Step

LOOK = 0.25  # seconds between two looks at the clock
#: Reasons of the kubelet's events: a pull has begun, an image is there.
PULLING, PULLED = "Pulling", "Pulled"
BEGIN = 20.0  # seconds after which a machine that has not begun to pull is not waited for
SPARE = 60.0  # seconds that a pod may outlive the wait, if our process is killed
#: What a pull needs of the pod that will run.
OF_POD = ("imagePullSecrets", "serviceAccountName", "tolerations")
#: What decides where the pod will run.
PLACEMENT = ("nodeSelector", "affinity")
#: A container that does not start is enough: its image is there by then. Events contain the word.
COMMAND = "rigel-only-pulls-the-image"
RESOURCES = {"cpu": "1m", "memory": "16Mi"}


@attrs.define
class Pull:
    """What one pod pulls on one machine.

    Attributes:
        images: each with its pull policy.
        steps: the changes that need them.
    """

    machine: str
    images: dict[str, str] = attrs.field(factory=dict)
    steps: list[Step] = attrs.field(factory=list)
    name: str = attrs.field(factory=lambda: f"rigel-pull-{uuid.uuid4().hex[:10]}")

    @property
    def title(self) -> str:
        """The images as a user writes them."""
        return ", ".join(image.partition("@")[0] for image in self.images)


def pull_images(run: Run, plan: Plan, good: int, still_ours: Callable[[], None]) -> None:
    """Return when the machines have the new images of workloads whose old pods end first.

    Args:
        good: the revision that runs, 0 if none became ready.
        still_ours: raises if the deploy must not continue (its Lease is lost).

    Raises:
        ClusterError: an image cannot be pulled, or not within the roll-out's time.
        Interrupted: `cancel` was set.
    """
    steps = [step for step in plan.changes if find_new_images(step)]
    if not steps:
        return
    cluster, space, own = run.cluster, run.release.namespace, run.release.name
    pods = cluster.list("v1", "Pod", space)
    remove(run, [ref_of(pod) for pod in pods if has_label(pod, PULL_LABEL, own)])
    pods = [pod for pod in pods if has_label(pod, RELEASE_LABEL, own)]
    try:
        nodes: Sequence[Manifest] | None = cluster.nodes()
    except ClusterError:  # we may not see machines
        nodes = None
    pulls = {ObjectRef("v1", "Pod", space, one.name): one for one in choose(steps, pods, nodes)}
    if not pulls:
        return
    try:
        made = cluster.parallel(partial(create, run), pulls.values())
        there = {ref: pulls[ref] for ref, done in zip(pulls, made, strict=True) if done}
        follow(run, there, good, still_ours)
    finally:
        remove(run, list(pulls))


def has_label(pod: Manifest, key: str, value: str) -> bool:
    return bool((pod["metadata"].get("labels") or {}).get(key) == value)


def find_new_images(step: Step) -> dict[str, str]:
    """Return the images that a change brings, with their policies, if it ends the old pods first.

    An optional workload may as well be without a pod for a while.
    """
    result, live = step.result, step.live
    if step.action != "change" or result is None or live is None or is_optional(result):
        return {}
    strategy = mapping(mapping(result.get("spec")).get("strategy"))
    if result["kind"] != "Deployment" or strategy.get("type") != "Recreate":
        return {}
    before = images_of([live])
    policies = {c["image"]: c.get("imagePullPolicy", "IfNotPresent") for c in containers(result)}
    return {i: p for i, p in policies.items() if i not in before and p != "Never"}


def choose(
    steps: Sequence[Step], pods: Sequence[Manifest], nodes: Sequence[Manifest] | None
) -> list[Pull]:
    """Return what to pull on which machines; pure.

    Only pods that do their work count: without one there is no gap to shorten.

    Args:
        pods: of the release.
        nodes: the machines; None if they are unknown: then each is taken for one that works.
    """
    known = None if nodes is None else {node["metadata"]["name"]: node for node in nodes}
    chosen: dict[str, Pull] = {}
    for step in steps:
        spec = pod_of(step.result or {})
        for machine in list_machines(step, pods):
            node = (known or {}).get(machine)
            if not stays(step, node, seen=known is not None):
                continue
            images = find_new_images(step).items()
            lacking = {i: policy for i, policy in images if not has_image(node, i, policy)}
            if lacking:
                key = json.dumps([machine, [spec.get(key) for key in OF_POD]], sort_keys=True)
                pull = chosen.setdefault(key, Pull(machine))
                pull.images |= lacking
                pull.steps.append(step)
    return list(chosen.values())


def stays(step: Step, node: Manifest | None, *, seen: bool) -> bool:
    """Whether a pod may be replaced on its machine, and that works.

    Args:
        seen: we may see machines; otherwise it stays if its placement does.
    """
    spec, old = pod_of(step.result or {}), pod_of(step.live or {})
    if not seen:
        return all(spec.get(key) == old.get(key) for key in PLACEMENT)
    return node is not None and is_ready(node) and may_run(spec, node)


def list_machines(step: Step, pods: Sequence[Manifest]) -> Iterator[str]:
    """Yield the machines on which pods of a Deployment do their work, each once."""
    own = (step.live or {})["spec"]["selector"].get("matchLabels") or {}
    found = [
        pod["spec"].get("nodeName")
        for pod in pods
        if stays_ready(pod) and own.items() <= (pod["metadata"].get("labels") or {}).items()
    ]
    yield from filter(None, dict.fromkeys(found))


def has_image(node: Manifest | None, image: str, policy: str) -> bool:
    """Whether a machine reports an image, and the kubelet would not look for a newer one."""
    try:
        reference = parse_reference(image)
    except UserError:  # the kubelet reports what is wrong with the name
        return False
    if node is None or (policy == "Always" and not reference.digest):
        return False
    name = f"{reference.name}@{reference.digest}" if reference.digest else str(reference)
    return name in list_loaded([node])


def make_pod(run: Run, pull: Pull) -> dict[str, Any]:
    """Return the pod that pulls; every level of Pod Security accepts it."""
    spec, owner = pod_of(pull.steps[0].result or {}), pull.steps[0].live or {}
    reference = {key: owner["metadata"][key] for key in ("name", "uid")}
    reference |= {key: owner[key] for key in ("apiVersion", "kind")}
    security = {"allowPrivilegeEscalation": False, "capabilities": {"drop": ["ALL"]}}
    made = [
        {
            "name": f"image-{number}",
            "image": image,
            "imagePullPolicy": policy,
            "command": [COMMAND],
            "securityContext": security,
            "resources": {"requests": RESOURCES, "limits": RESOURCES},
        }
        for number, (image, policy) in enumerate(pull.images.items())
    ]
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {
            "name": pull.name,
            "namespace": run.release.namespace,
            "labels": {PULL_LABEL: run.release.name},
            "ownerReferences": [reference],
        },
        "spec": {
            **{key: spec[key] for key in OF_POD if key in spec},
            "nodeName": pull.machine,
            "restartPolicy": "Never",
            "terminationGracePeriodSeconds": 0,
            "activeDeadlineSeconds": int(run.options.limit + SPARE),
            "automountServiceAccountToken": False,
            "enableServiceLinks": False,
            "securityContext": {
                "runAsNonRoot": True,
                "runAsUser": 65534,
                "seccompProfile": {"type": "RuntimeDefault"},
            },
            "containers": made,
        },
    }


def create(run: Run, pull: Pull) -> bool:
    """Create the pod of a pull; return whether it exists: a policy or a quota may refuse it."""
    try:
        run.cluster.create(make_pod(run, pull))
    except Refusal as error:
        return isinstance(error, Conflict)  # the answer to an earlier request was lost
    return True


def remove(run: Run, refs: Sequence[ObjectRef]) -> None:
    """Delete pods that pull, at once."""

    def end(ref: ObjectRef) -> None:
        try:
            run.cluster.delete(ref, grace_seconds=0)
        except Forbidden:  # without the right for it, none was created
            pass
        except ClusterError as error:
            run.report.warn(f"{ref} is left, and ends automatically: {error}")

    run.cluster.parallel(end, refs)


def follow(
    run: Run, pulls: Mapping[ObjectRef, Pull], good: int, still_ours: Callable[[], None]
) -> None:
    """Wait until all images are there; raises as pull_images."""
    waiting, begun, ledger = dict(pulls), set[ObjectRef](), Ledger(run.patience)
    started = time.monotonic()
    deadline = started + run.options.limit - run.cluster.sum_outages()
    with ReleaseView(run.cluster, run.release.namespace, run.options.limit + SPARE) as view:
        view.watch([POD], labels=f"{PULL_LABEL}={run.release.name}")
        for reason in (PULLING, PULLED):
            view.watch([EVENT], fields=f"reason={reason}")
        while waiting:
            view.refresh(LOOK)
            now = time.monotonic()
            live = {ref: there for ref in waiting if (there := view.find(ref)) is not None}
            for ref in find_begun(view, live) - begun:
                begun.add(ref)
                state = f"pulls {waiting[ref].title} before the update"
                run.report.progress(waiting[ref].machine, state)
            causes = [(ref, cause) for ref, pod in live.items() for cause in find_causes(pod)]
            fresh, _ = ledger.note(now, causes)
            for seen in fresh:
                run.report.progress(waiting[seen.ref].machine, seen.cause.message)
            for hopeless in ledger.find_hopeless(now):
                what, kind = hopeless.cause.message, hopeless.cause.kind
                known = [(waiting[one.ref], one.cause.message) for one in ledger.seen.values()]
                same = [pull for pull, message in known if message == what]
                others = [f"{pull.machine}: {text}" for pull, text in known if text != what]
                raise failure(same, what, CAUSES[kind].remedy, good, others)
            for ref, pull in list(waiting.items()):
                if ref in live and is_over(live[ref], find_pulled(view, live[ref])):
                    if ref in begun:
                        run.report.progress(pull.machine, f"has pulled {pull.title}", done=True)
                    del waiting[ref]
                elif ref not in live if ref in begun else now > started + BEGIN:
                    del waiting[ref]  # another program deleted it, or its machine does not begin
            still_ours()
            if waiting and now > deadline + run.cluster.sum_outages():
                late = list(waiting.values())
                what = f"{late[0].title} is not pulled after {run.options.limit:g} s"
                raise failure(late, what, "set a longer --timeout", good)
            if waiting and run.options.cancel.is_set():
                raise Interrupted(
                    "interrupted while images were being pulled; nothing was changed",
                    hint="run the same command again",
                )


def find_begun(view: ReleaseView, live: Mapping[ObjectRef, Manifest]) -> set[ObjectRef]:
    """Return the pods whose kubelet has begun to pull; without events, those that it has seen."""
    pulling = {about.get("uid") for about in list_about(view, PULLING)}
    blind = EVENT in view.refused
    return {
        ref
        for ref, pod in live.items()
        if pod["metadata"]["uid"] in pulling
        or (blind and (pod.get("status") or {}).get("containerStatuses"))
    }


def find_pulled(view: ReleaseView, pod: Manifest) -> set[str]:
    """Return the names of a pod's containers whose images are there by the kubelet's events.

    An event comes at once; the pod's status follows when the kubelet looks at containers again,
    once a second.
    """
    uid = pod["metadata"]["uid"]
    own = [about for about in list_about(view, PULLED) if about.get("uid") == uid]
    found = [re.fullmatch(r"spec\.containers\{(.+)\}", one.get("fieldPath") or "") for one in own]
    return {match[1] for match in found if match}


def list_about(view: ReleaseView, reason: str) -> list[Manifest]:
    """Return what the events with a reason are about."""
    events = view.objects[EVENT].values()
    return [event["involvedObject"] for event in events if event.get("reason") == reason]


def find_causes(pod: Manifest) -> Iterator[Cause]:
    """Yield why a pod's images cannot be pulled."""
    return (one for one in explain_pod(pod, ()) if one.kind in ("image", "image-name"))


def is_over(pod: Manifest, pulled: Collection[str] = ()) -> bool:
    """Whether all images of a pod are there, or it has ended without them.

    Args:
        pulled: the names of the containers whose images are known to be there.
    """
    status = pod.get("status") or {}
    states = {one["name"]: one.get("state") or {} for one in status.get("containerStatuses") or ()}
    left = [
        states.get(one["name"], {})
        for one in pod["spec"]["containers"]
        if one["name"] not in pulled
    ]
    return status.get("phase") in ("Succeeded", "Failed") or all(
        state.keys() & {"running", "terminated"}
        or (state.get("waiting") or {}).get("reason") in START
        for state in left
    )


def failure(
    pulls: Sequence[Pull], what: str, remedy: str, good: int, details: Sequence[str] = ()
) -> ClusterError:
    """Return the error for images that cannot be pulled."""
    number = f" (revision {good})" if good else ""
    steps = [(step, pull.machine) for pull in pulls for step in pull.steps]
    names = ", ".join(f"{step.ref.name} on {machine}" for step, machine in steps)
    own = next(filter(None, (image_remedy_of(step.result or {}) for step, _ in steps)), "")
    return ClusterError(
        f"the old version still runs{number}; {names} cannot be updated: {what}",
        hint="; ".join(filter(None, (own, remedy, "nothing was changed"))),
        details=details,
    )

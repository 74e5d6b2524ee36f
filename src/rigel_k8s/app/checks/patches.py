"""What is wrong with raw parts of a Deployment or Job that are merged into the generated ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rigel_k8s.app.checks.schema import Place, check_value, show
from rigel_k8s.image_reference import is_reference
from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.overlay import containers_of, find_below, pod_of
from rigel_k8s.objects.scalars import ImageRef
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem

#: What both need; null would remove it.
NEEDED = frozenset({"metadata", "spec", "template", "containers"})
#: What a patch may repeat: the API version, by the kind.
TOP = {"Deployment": "apps/v1", "Job": "batch/v1"}
POD = ("spec", "template", "spec")
#: What identifies a workload, and its pods.
FIXED = (
    *(("metadata", "name"), ("metadata", "namespace"), ("spec", "selector")),
    *(("metadata", "labels", key) for key in (NAME_LABEL, RELEASE_LABEL)),
    *(("spec", "template", "metadata", "labels", key) for key in (NAME_LABEL, RELEASE_LABEL)),
)


def check_patch(path: Path, tree: Mapping[str, Any], kind: str = "Deployment") -> Iterator[Problem]:
    """Yield what is wrong with a part of a workload that is merged into the generated one."""
    for field in FIXED:
        if find_below(tree, field) is not None:
            message = f"{'.'.join(field)} identifies the release and cannot change"
            yield Problem((*path, *field), message, "fixed-field", at_key=True)
    for key, value in {"apiVersion": TOP[kind], "kind": kind}.items():
        if tree.get(key) not in (None, value):
            message = f"{key} of a {kind} is {value}: remove it"
            yield Problem((*path, key), message, "fixed-field", at_key=True)
    restart = pod_of(tree).get("restartPolicy")
    if restart is not None and (restart == "Always") is (kind == "Job"):
        fits = "OnFailure or Never" if kind == "Job" else "Always (a `kind: task` runs once)"
        message = f"restartPolicy of a {kind} is {fits}: remove it"
        yield Problem((*path, *POD, "restartPolicy"), message, "fixed-field", at_key=True)
    for index, one in enumerate(containers_of(tree)):
        image = str(one.get("image") or "a")
        if not has_template(image) and not is_reference(image):
            message = f'"{image}" is not {ImageRef.expects}'
            yield Problem((*path, *POD, "containers", index, "image"), message, ImageRef.kind)
    yield from check_needed(tree, Place(path, f"a {kind}"))
    yield from check_value(tree, kind, Place(path, f"a {kind}"))


def check_needed(tree: Any, place: Place) -> Iterator[Problem]:
    """Yield null where it would remove what a workload needs."""
    for key in NEEDED & tree.keys() if isinstance(tree, Mapping) else ():
        here = place.below(str(key))
        if tree[key] is None:
            what = show(here).partition(" of ")[0]
            text = f"{what} cannot be removed: {place.title} needs it"
            yield here.problem(text, "fixed-field", at_key=True)
        yield from check_needed(tree[key], here)

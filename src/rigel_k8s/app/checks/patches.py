"""What is wrong with raw parts of a Deployment: fields that no patch may change, and their shape.

Kubernetes checks every field; these are the ones that our own code reads.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

from rigel_k8s.problems import Path, Problem

Shape: TypeAlias = "Mapping[str, Shape] | Sequence[Shape]"

#: A shape is a mapping of its keys' shapes, or a list with the shape of its items. Other keys
#: may have any value.
MAPPING: Shape = {}
LIST: Shape = (MAPPING,)
META: Shape = {"labels": MAPPING, "annotations": MAPPING}
CONTAINER: Shape = {
    "env": LIST,
    "envFrom": LIST,
    "ports": LIST,
    "volumeMounts": LIST,
    "resources": MAPPING,
    "lifecycle": MAPPING,
    "securityContext": MAPPING,
    "startupProbe": MAPPING,
    "readinessProbe": MAPPING,
    "livenessProbe": MAPPING,
}
POD: Shape = {
    "containers": (CONTAINER,),
    "initContainers": (CONTAINER,),
    "volumes": LIST,
    "tolerations": LIST,
    "imagePullSecrets": LIST,
    "hostAliases": LIST,
    "nodeSelector": MAPPING,
    "affinity": MAPPING,
    "securityContext": MAPPING,
}
DEPLOYMENT: Shape = {
    "metadata": META,
    "spec": {"strategy": MAPPING, "template": {"metadata": META, "spec": POD}},
}
#: What a Deployment needs; null would remove it.
NEEDED = frozenset(
    {
        ("metadata",),
        ("spec",),
        ("spec", "template"),
        ("spec", "template", "metadata"),
        ("spec", "template", "spec"),
        ("spec", "template", "spec", "containers"),
    }
)


def check_patch(path: Path, tree: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what is wrong with a part of a Deployment that is merged into the generated one."""
    yield from check_fixed(path, tree)
    yield from check_shape(path, (), tree, DEPLOYMENT)


def check_fixed(path: Path, tree: object) -> Iterator[Problem]:
    """Yield the fields that no patch may change."""
    for field in (("metadata", "name"), ("metadata", "namespace"), ("spec", "selector")):
        place = tree
        for key in field:
            place = place.get(key) if isinstance(place, dict) else None
        if place is not None:
            message = f"{'.'.join(field)} identifies the release and cannot change"
            yield Problem((*path, *field), message, "fixed-field", at_key=True)


def check_shape(path: Path, field: Path, tree: object, shape: Shape) -> Iterator[Problem]:
    """Yield the values that are not of the shape that Kubernetes gives their fields.

    Args:
        path: where the patch is in the options.
        field: where `tree` is in the patch.
    """
    name = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in field).lstrip(".")
    if tree is None:
        if field in NEEDED:
            message = f"{name} cannot be removed: a Deployment needs it"
            yield Problem((*path, *field), message, "fixed-field", at_key=True)
    elif isinstance(shape, Mapping):
        if not isinstance(tree, Mapping):
            yield _wrong_type((*path, *field), name, "a mapping", tree)
            return
        for key, value in tree.items():
            if key in shape:
                yield from check_shape(path, (*field, str(key)), value, shape[key])
    elif not isinstance(tree, Sequence) or isinstance(tree, str):
        yield _wrong_type((*path, *field), name, "a list", tree)
    else:
        for index, item in enumerate(tree):
            yield from check_shape(
                path, (*field, index), item if item is not None else "", shape[0]
            )


def _wrong_type(path: Path, name: str, kind: str, value: object) -> Problem:
    """Return the problem of a value of a kind that Kubernetes refuses there."""
    found = {str: "text", bool: "true or false", int: "a number", float: "a number"}
    other = "a list" if isinstance(value, Sequence) else "a mapping"
    message = f"{name} of a Deployment must be {kind}, not {found.get(type(value), other)}"
    return Problem(path, message, "wrong-type")

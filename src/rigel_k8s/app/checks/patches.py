"""What is wrong with raw parts of a Deployment: fields that no patch may change, and their shape.

Kubernetes knows every field; here are those that our own code reads and goes on from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeAlias

from rigel_k8s.problems import Path, Problem

Shape: TypeAlias = "Mapping[str, Shape] | Sequence[Shape]"

#: A shape is a mapping of its keys' shapes, or a list with the shape of its items. Keys that do not
#: stand here may have any value.
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
#: What a Deployment cannot be without; null would take it away.
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
    """Yield what is wrong with a part of a Deployment that is laid over what is generated."""
    yield from check_fixed(path, tree)
    yield from check_shape(path, (), tree, DEPLOYMENT)


def check_fixed(path: Path, tree: object) -> Iterator[Problem]:
    """Yield the fields that no patch may change."""
    for field in (("metadata", "name"), ("metadata", "namespace"), ("spec", "selector")):
        place = tree
        for key in field:
            place = place.get(key) if isinstance(place, dict) else None
        if place is not None:
            message = f"{'.'.join(field)} is what a release is recognised by and cannot change"
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


def _wrong_type(path: Path, name: str, wanted: str, value: object) -> Problem:
    """Return the problem of a value that is not what Kubernetes wants there."""
    found = {str: "text", bool: "true or false", int: "a number", float: "a number"}
    kind = "a list" if isinstance(value, Sequence) else "a mapping"
    message = f"{name} of a Deployment must be {wanted}, not {found.get(type(value), kind)}"
    return Problem(path, message, "wrong-type")

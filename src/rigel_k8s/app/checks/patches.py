"""What is wrong with raw parts of a Deployment: fields that no patch may change, and their shape.

Kubernetes checks every field; these are the ones that our own code reads.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.problems import Path, Problem

#: What a Deployment needs; null would remove it.
NEEDED = frozenset({"metadata", "spec", "template", "containers"})
#: Fields whose own fields are checked, too. Others may have any: a label may be called `env`.
INNER = NEEDED | {"initContainers"}
MAPPINGS = frozenset(
    {"metadata", "labels", "annotations", "spec", "strategy", "template"}
    | {"nodeSelector", "affinity", "securityContext", "resources", "lifecycle"}
    | {"startupProbe", "readinessProbe", "livenessProbe"}
)
#: Lists of mappings.
LISTS = frozenset(
    {"containers", "initContainers", "volumes", "tolerations", "imagePullSecrets", "hostAliases"}
    | {"env", "envFrom", "ports", "volumeMounts"}
)


def check_patch(path: Path, tree: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what is wrong with a part of a Deployment that is merged into the generated one."""
    for field in (("metadata", "name"), ("metadata", "namespace"), ("spec", "selector")):
        above = tree.get(field[0])
        if isinstance(above, Mapping) and above.get(field[1]) is not None:
            message = f"{'.'.join(field)} identifies the release and cannot change"
            yield Problem((*path, *field), message, "fixed-field", at_key=True)
    yield from check_shape(path, (), tree)


def check_shape(path: Path, field: Path, tree: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield the values that are not of the shape that Kubernetes gives their fields.

    Args:
        path: where the patch is in the options.
        field: where `tree` is in the patch.
    """
    for key, value in tree.items():
        here = (*field, str(key))
        if value is None and key in NEEDED:
            message = f"{show(here)} cannot be removed: a Deployment needs it"
            yield Problem((*path, *here), message, "fixed-field", at_key=True)
        elif value is None or key not in MAPPINGS | LISTS:
            continue
        elif key in LISTS and (isinstance(value, str) or not isinstance(value, Sequence)):
            yield wrong_type(path, here, "a list", value)
        else:
            listed = [(here, value)]
            if key in LISTS:
                listed = [((*here, index), item) for index, item in enumerate(value)]
            for place, item in listed:
                if not isinstance(item, Mapping):
                    yield wrong_type(path, place, "a mapping", item)
                elif key in INNER:
                    yield from check_shape(path, place, item)


def wrong_type(path: Path, field: Path, kind: str, value: object) -> Problem:
    """Return the problem of a value of a kind that Kubernetes refuses there."""
    names = {type(None): "empty", str: "text", bool: "true or false", int: "a number"}
    other = {float: "a number", dict: "a mapping"}.get(type(value), "a list")
    message = f"{show(field)} of a Deployment must be {kind}, not {names.get(type(value), other)}"
    return Problem((*path, *field), message, "wrong-type")


def show(field: Path) -> str:
    """Return a field as people write it: spec.template.spec.containers[0].env."""
    return "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in field).lstrip(".")

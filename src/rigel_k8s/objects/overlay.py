"""Laying one tree of plain data over another, as users expect of Kubernetes objects."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

#: Lists whose items have an identity, as Kubernetes' own merge patches have it.
IDENTITIES: Mapping[str, str] = {
    "containers": "name",
    "initContainers": "name",
    "env": "name",
    "volumes": "name",
    "volumeMounts": "mountPath",
    "volumeDevices": "devicePath",
    "ports": "containerPort",
    "imagePullSecrets": "name",
    "hostAliases": "ip",
}

#: Unions, where a mix of two values would be invalid: replaced as a whole.
WHOLE = frozenset(
    {"readinessProbe", "livenessProbe", "startupProbe", "preStop", "postStart", "strategy"}
)
WHOLE_ITEMS = frozenset({"volumes", "env"})

SCALARS = frozenset({str, int, float, bool, type(None)})


def merge(base: Any, over: Any, key: str = "") -> Any:
    """Return `base` with `over` laid on it, as plain data; neither is changed.

    Mappings are merged key by key, and null removes a key. Containers, variables, mounts and the
    like are merged by name, so that a container written as a whole still gets its ROS environment;
    any other list, and any scalar, replaces.
    """
    if isinstance(base, Mapping) and isinstance(over, Mapping) and key not in WHOLE:
        return merge_mappings(base, over)
    identity = IDENTITIES.get(key)
    if identity and has_identity(base, identity) and has_identity(over, identity):
        return merge_items(base, over, identity, whole=key in WHOLE_ITEMS)
    return simplify(over)


def has_identity(value: Any, identity: str) -> bool:
    """Return whether a value is a list of mappings that all have a key."""
    return isinstance(value, list | tuple) and all(
        isinstance(item, Mapping) and identity in item for item in value
    )


def merge_mappings(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge key by key."""
    result = {}
    for key, value in base.items():
        if key not in over:
            result[str(key)] = simplify(value)
        elif over[key] is not None:
            result[str(key)] = merge(value, over[key], key)
    for key, value in over.items():
        if key not in base and value is not None:
            result[str(key)] = simplify(value)
    if "readinessProbe" in over and "startupProbe" not in over:
        result.pop("startupProbe", None)  # a probe of the user's own is the only one that counts
    return result


def merge_items(
    base: Sequence[Any], over: Sequence[Any], identity: str, *, whole: bool
) -> list[Any]:
    """Merge items of the same identity, keep the others, append what is new."""
    new = {item[identity]: item for item in over}
    merged = [one_item(item, new.get(item[identity]), whole=whole) for item in base]
    known = {item[identity] for item in base}
    return merged + [simplify(item) for item in over if item[identity] not in known]


def one_item(base: Any, over: Any, *, whole: bool) -> Any:
    """Return an item with the other laid over it, if there is one."""
    if over is None:
        return simplify(base)
    return simplify(over) if whole else merge(base, over)


def simplify(value: Any) -> Any:
    """Return the same data of JSON's own types only."""
    if type(value) in SCALARS:  # most are, and each value of a release passes here several times
        return value
    if isinstance(value, dict | Mapping):  # dict first: isinstance(…, Mapping) is slow
        return {
            str(key): item if type(item) in SCALARS else simplify(item)
            for key, item in value.items()
        }
    for kind in (str, int, float):
        if isinstance(value, kind):
            return kind(value)
    if isinstance(value, list | tuple):
        return [item if type(item) in SCALARS else simplify(item) for item in value]
    return str(value)


T = TypeVar("T")


def parse_json(text: str | None, otherwise: T) -> T:
    """Return an annotation's JSON as data; `otherwise` if it is invalid, or of another type."""
    try:
        found = json.loads(text or "")
    except (ValueError, RecursionError):
        return otherwise
    return found if isinstance(found, type(otherwise)) else otherwise


def mapping(value: Any) -> Mapping[str, Any]:
    """Return a mapping; an empty one for anything else."""
    return value if isinstance(value, Mapping) else {}


def list_mappings(value: Any) -> Iterator[Mapping[str, Any]]:
    items = value if isinstance(value, list | tuple) else ()
    yield from (one for one in items if isinstance(one, Mapping))


def find_below(tree: Any, path: Sequence[str]) -> Any:
    """Return what is at a path of mappings, None if nothing is."""
    for key in path:
        tree = mapping(tree).get(key)
    return tree


def pod_of(tree: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the spec of the pods of a part of a Deployment."""
    return mapping(find_below(tree, ("spec", "template", "spec")))


def containers_of(tree: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the containers of a part of a Deployment."""
    return list(list_mappings(pod_of(tree).get("containers")))

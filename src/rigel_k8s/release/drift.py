"""What others have added or changed in our objects, by the ownership that Kubernetes keeps; pure.

Labels, annotations and finalizers are left alone: other tools keep notes there, and they change
nothing that runs. So is the note of a restart in a pod's template. What someone removed has no
owner; the plan shows it as a change.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.objects.marks import FIELD_MANAGER, RESTARTED_ANNOTATION
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.labelling import find_owned_fields, is_other_tool, names_item

RESTARTED = f"f:{RESTARTED_ANNOTATION}"
#: A reader knows without it where `env FOO` and `image` are.
IN_CONTAINER = ("f:spec", "f:template", "f:spec", "f:containers")


@attrs.frozen
class Drift:
    """One field, or item of a list, that another manager owns and we do not.

    Attributes:
        path: its steps as in `managedFields`: `f:spec`, `k:{"name":"x"}`.
    """

    manager: str
    path: tuple[str, ...]
    text: str


def find_drift(live: Manifest) -> list[Drift]:
    """Return what others have added or changed in an object that we have applied."""
    ours = find_owned_fields(live)
    if ours is None:
        return []
    return [
        Drift(entry["manager"], path, describe(path, live))
        for entry in live["metadata"].get("managedFields") or []
        if is_other_tool(entry) and entry["manager"] != FIELD_MANAGER
        for key, fields in (entry.get("fieldsV1") or {}).items()
        if key != "f:metadata"
        for path in list_foreign(fields, ours.get(key), (key,))
    ]


def list_foreign(
    theirs: Mapping[str, Any], ours: Mapping[str, Any] | None, path: tuple[str, ...]
) -> Iterator[tuple[str, ...]]:
    """Yield the paths of what others own in a tree and we do not: items of lists as a whole.

    Args:
        ours: our tree at this path, None where we own nothing; an empty one is owned as a whole.
    """
    if ours is None and (not theirs or path[-1][0] in "kv"):
        yield path
    elif ours != {}:
        for step, fields in theirs.items():
            if step not in (".", RESTARTED):
                yield from list_foreign(fields, (ours or {}).get(step), (*path, step))


def describe(path: tuple[str, ...], live: Manifest) -> str:
    """Return a path in words: `env FOO`, `image`, `replicas 2`."""
    words = [" ".join(map(str, json.loads(s[2:]).values())) if s[0] == "k" else s[2:] for s in path]
    if path == ("f:spec", "f:replicas"):
        return f"replicas {live['spec'].get('replicas')}"
    if path[:4] == IN_CONTAINER:
        words = words[5:7] if path[5:6] == ("f:env",) else words[5:] or words[3:]
    return " ".join(words)


def describe_drift(live: Manifest) -> list[str]:
    """Return for each manager, as a sentence's end, what it has changed in an object."""
    found: dict[str, list[str]] = {}
    for one in find_drift(live):
        found.setdefault(one.manager, []).append(one.text)
    return [
        f"was changed by {manager}: {', '.join(dict.fromkeys(texts))}"
        for manager, texts in found.items()
    ]


def describe_halt(live: Manifest) -> str:
    """Return that someone has stopped a workload, or the roll-out of its updates; "" if no one has.

    Kubernetes keeps no owner of a number of pods that `kubectl scale` has set.
    """
    ours = (find_owned_fields(live) or {}).get("f:spec")
    if not ours or live["kind"] not in ("Deployment", "StatefulSet"):
        return ""
    if live["spec"].get("replicas") == 0 and "f:replicas" not in ours:
        return "someone has scaled it to 0 pods"
    if live["spec"].get("paused") and "f:paused" not in ours:
        return "someone has paused its roll-outs"
    return ""


def remove_drift(live: Manifest) -> dict[str, Any]:
    """Return an object without what others have added."""
    made = dict(live)
    for one in find_drift(live):
        made = remove(made, one.path)
    return made


def remove(value: Any, path: tuple[str, ...]) -> Any:
    """Return a part of an object without what is at a path."""
    step, rest = path[0], path[1:]
    if isinstance(value, list):
        kept = [item for item in value if rest or not names_item(step, item)]
        return [remove(item, rest) if names_item(step, item) else item for item in kept]
    key = step[2:]
    if not isinstance(value, dict) or key not in value:
        return value
    left = remove(value[key], rest) if rest else None
    others = {name: part for name, part in value.items() if name != key}
    return {**others, key: left} if left else others

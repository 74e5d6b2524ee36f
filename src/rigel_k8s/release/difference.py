"""A plan as text, as `diff -u` shows it; pure."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from typing import Any

import yaml

from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.labelling import HASH_ANNOTATION
from rigel_k8s.release.plan import substance
from rigel_k8s.release.types import Step

HIDDEN_NOTES = (HASH_ANNOTATION, "deployment.kubernetes.io/revision")


def difference(steps: Iterable[Step]) -> str:
    """Return what steps change as a unified diff, "" if they change nothing."""
    return "".join(step_difference(step) for step in steps if step.writes)


def step_difference(step: Step) -> str:
    """Return what one step changes."""
    old = lines(step.live if step.action != "create" else None, step.result, "as it is")
    new = lines(step.result if step.action != "prune" else None, step.live, "changed")
    name = str(step.ref)
    return "".join(difflib.unified_diff(old, new, f"{name} (cluster)", f"{name} (Rigelfile)"))


def lines(shown: Manifest | None, other: Manifest | None, word: str) -> list[str]:
    """Return an object as lines of YAML; hidden values that differ from `other` are marked."""
    if shown is None:
        return []
    content = substance(shown)
    notes = content["metadata"].get("annotations") or {}
    notes = {key: value for key, value in notes.items() if key not in HIDDEN_NOTES}
    content["metadata"] = {**content["metadata"], "annotations": notes}
    if content["kind"] == "Secret":
        content["data"] = dict(hide_values(content.get("data") or {}, other, word))
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return str(yaml.dump(content, Dumper=dumper, width=1000)).splitlines(keepends=True)


def hide_values(
    data: dict[str, Any], other: Manifest | None, word: str
) -> Iterator[tuple[str, str]]:
    """Yield a Secret's keys; a value shows only whether it equals the other side's."""
    there = (other or {}).get("data") or {}
    for key, value in data.items():
        yield key, "(hidden)" if there.get(key) == value else f"(hidden, {word})"

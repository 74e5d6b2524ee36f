"""What is ours on the cluster: labels and hashes that we give, and fields that we own."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from typing import Any

from rigel_k8s.objects.marks import FIELD_MANAGER, RELEASE_LABEL
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.types import Desired, ReleaseId, rank

HASH_ANNOTATION = "rigel-k8s/hash"
#: On cluster-wide objects: the namespace of the release that they belong to.
NAMESPACE_ANNOTATION = "rigel-k8s/namespace"


def manifests_to_apply(desired: Desired) -> tuple[Manifest, ...]:
    """Return all manifests as apply sends them, in the order of apply."""
    made = [add_hash(add_label(encode_secret(m), desired.release)) for m in desired.objects]
    return tuple(sorted(made, key=lambda m: rank(m["kind"])))


def hash_of(manifest: Manifest) -> str:
    """Return the hash that a prepared or live object carries, "" for none."""
    annotations = manifest["metadata"].get("annotations") or {}
    return str(annotations.get(HASH_ANNOTATION, ""))


def add_label(manifest: Manifest, release: ReleaseId) -> dict[str, Any]:
    meta = dict(manifest["metadata"])
    meta["labels"] = {**(meta.get("labels") or {}), RELEASE_LABEL: release.name}
    if not meta.get("namespace"):
        own = {NAMESPACE_ANNOTATION: release.namespace}
        meta["annotations"] = {**(meta.get("annotations") or {}), **own}
    return {**manifest, "metadata": meta}


def add_hash(manifest: Manifest) -> dict[str, Any]:
    meta = dict(manifest["metadata"])
    others = {k: v for k, v in (meta.get("annotations") or {}).items() if k != HASH_ANNOTATION}
    text = json.dumps({**manifest, "metadata": {**meta, "annotations": others}}, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:20]
    meta["annotations"] = {**others, HASH_ANNOTATION: digest}
    return {**manifest, "metadata": meta}


def encode_secret(manifest: Manifest) -> Manifest:
    """Return a Secret with `data` only: `stringData` cannot be read back."""
    if manifest["kind"] != "Secret" or "stringData" not in manifest:
        return manifest
    texts = manifest["stringData"] or {}
    data = {key: base64.b64encode(str(text).encode()).decode() for key, text in texts.items()}
    rest = {key: value for key, value in manifest.items() if key != "stringData"}
    return {**rest, "data": {**(manifest.get("data") or {}), **data}}


#: Managers that are part of Kubernetes, or of a release (its gate keeps its memory in a Secret):
#: what they set does not come from another tool.
CONTROLLERS = ("kube-", "kubelet", "k3s", "cloud-controller", "rigel-gate")


def find_owned_fields(live: Manifest) -> Mapping[str, Any] | None:
    """Return the tree of the fields that we applied, None if we applied none."""
    for entry in live["metadata"].get("managedFields") or []:
        if is_ours(entry):
            fields: Mapping[str, Any] = entry.get("fieldsV1") or {}
            return fields
    return None


def is_applied(live: Manifest) -> bool:
    """Whether we have applied an object (and no controller has made it)."""
    return find_owned_fields(live) is not None


def covers(manifest: Manifest, live: Manifest) -> bool:
    """Whether every field of a manifest is still owned by us: no one has changed it since."""
    fields = find_owned_fields(live)
    if fields is None:
        return False
    said = {k: v for k, v in manifest.items() if k not in ("apiVersion", "kind", "metadata")}
    meta = {k: v for k, v in manifest["metadata"].items() if k not in ("name", "namespace")}
    return owns({**said, "metadata": meta}, fields)


def owns(value: object, fields: Mapping[str, Any]) -> bool:
    """Whether a tree of fields contains all of a value."""
    if not fields or not isinstance(value, (dict, list)):
        return True
    if isinstance(value, list):
        return all(
            any(names_item(step, item) and owns(item, tree) for step, tree in fields.items())
            for item in value
        )
    return all(
        f"f:{key}" in fields and owns(part, fields[f"f:{key}"])
        for key, part in value.items()
        if part not in (None, {}, [])
    )


def names_item(step: str, item: object) -> bool:
    """Whether a step of a path is that of an item of a list."""
    kind, _, key = step.partition(":")
    if kind == "k" and isinstance(item, dict):
        names = json.loads(key)  # may have defaults that the item leaves out
        return all(item.get(name, value) == value for name, value in names.items())
    return kind == "v" and bool(json.loads(key) == item)


def managers(live: Manifest) -> tuple[str, ...]:
    """Return the names of the other tools that have set fields of an object."""
    entries = live["metadata"].get("managedFields") or []
    return tuple(dict.fromkeys(entry["manager"] for entry in entries if is_other_tool(entry)))


def take_over(live: Manifest) -> list[dict[str, Any]]:
    """Return the records of ownership with all that other tools had set as ours.

    The next apply then removes what they had set and our manifest does not have.
    """
    entries = live["metadata"].get("managedFields") or []
    kept = [entry for entry in entries if not is_other_tool(entry) and not is_ours(entry)]
    mine = [entry for entry in entries if is_other_tool(entry) or is_ours(entry)]
    fields: dict[str, Any] = {}
    for entry in mine:
        fields = union(fields, entry.get("fieldsV1") or {})
    if not fields:
        return kept
    ours = {
        "manager": FIELD_MANAGER,
        "operation": "Apply",
        "apiVersion": mine[0]["apiVersion"],
        "fieldsType": "FieldsV1",
        "fieldsV1": fields,
    }
    return [*kept, ours]


def union(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Return a tree with the fields of both."""
    both = dict(one)
    for key, tree in other.items():
        both[key] = union(both[key], tree) if key in both else tree
    return both


def is_ours(entry: Mapping[str, Any]) -> bool:
    """Whether a record of ownership is of our applies."""
    return (
        entry.get("manager") == FIELD_MANAGER
        and entry.get("operation") == "Apply"
        and not entry.get("subresource")
    )


def is_other_tool(entry: Mapping[str, Any]) -> bool:
    """Whether a record of ownership is of another tool (or of a person with kubectl).

    `kubectl scale` writes a part of the object, its `scale`; a status is written by controllers.
    """
    return (
        not is_ours(entry)
        and entry.get("subresource", "") in ("", "scale")
        and not str(entry.get("manager", "")).startswith(CONTROLLERS)
    )

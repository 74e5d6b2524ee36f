"""Manifests as they are sent: labelled as the release's, with a hash that shows changes.

Pure; `render` prints what this makes, `apply` sends the same.
"""

from __future__ import annotations

import base64
import hashlib
import json
from typing import Any

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.order import rank
from rigel_k8s.release.types import Desired, ReleaseId

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
    """Return a manifest with labels of its release."""
    meta = dict(manifest["metadata"])
    meta["labels"] = {**(meta.get("labels") or {}), RELEASE_LABEL: release.name}
    if not meta.get("namespace"):
        own = {NAMESPACE_ANNOTATION: release.namespace}
        meta["annotations"] = {**(meta.get("annotations") or {}), **own}
    return {**manifest, "metadata": meta}


def add_hash(manifest: Manifest) -> dict[str, Any]:
    """Return a manifest with the hash of its content."""
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

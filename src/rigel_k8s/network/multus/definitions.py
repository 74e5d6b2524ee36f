"""The kinds that Multus and whereabouts bring: their CustomResourceDefinitions."""

from __future__ import annotations

from typing import Any

__all__ = ["attachment_definition", "whereabouts_definitions"]

Object = dict[str, Any]

TEXT: Object = {"type": "string"}
WHEREABOUTS = "whereabouts.cni.cncf.io"


def attachment_definition() -> Object:
    """Return the kind NetworkAttachmentDefinition, as the Network Plumbing Group defines it."""
    names = {
        "kind": "NetworkAttachmentDefinition",
        "listKind": "NetworkAttachmentDefinitionList",
        "plural": "network-attachment-definitions",
        "singular": "network-attachment-definition",
        "shortNames": ["nad", "net-attach-def"],
    }
    config = {**TEXT, "description": "The CNI configuration, as JSON text."}
    spec = {"type": "object", "properties": {"config": config}}
    return _definition("k8s.cni.cncf.io", "v1", names, {"properties": {"spec": spec}})


def whereabouts_definitions() -> tuple[Object, ...]:
    """Return the kinds in which whereabouts keeps who has which address."""
    return (_pools(), _reservations(), _slices())


def _pools() -> Object:
    allocation = _record({"id": TEXT, "ifname": TEXT, "podref": TEXT}, "id", "podref")
    spec = _record(
        {"allocations": {"type": "object", "additionalProperties": allocation}, "range": TEXT},
        "allocations",
        "range",
    )
    return _definition(WHEREABOUTS, "v1alpha1", _names("IPPool"), {"properties": {"spec": spec}})


def _reservations() -> Object:
    spec = _record({"containerid": TEXT, "ifname": TEXT, "podref": TEXT}, "podref")
    schema = {"required": ["spec"], "properties": {"spec": spec}}
    return _definition(WHEREABOUTS, "v1alpha1", _names("OverlappingRangeIPReservation"), schema)


def _slices() -> Object:
    spec = _record({"range": TEXT, "sliceSize": TEXT}, "range", "sliceSize")
    one = _record({"nodeName": TEXT, "sliceRange": TEXT}, "nodeName", "sliceRange")
    status = _record({"allocations": {"type": "array", "items": one}}, "allocations")
    schema = {"properties": {"spec": spec, "status": status}}
    return _definition(WHEREABOUTS, "v1alpha1", _names("NodeSlicePool"), schema)


def _names(kind: str) -> Object:
    singular = kind.lower()
    return {
        "kind": kind,
        "listKind": f"{kind}List",
        "plural": f"{singular}s",
        "singular": singular,
    }


def _record(properties: Object, *required: str) -> Object:
    return {"type": "object", "properties": properties, "required": list(required)}


def _definition(group: str, version: str, names: Object, schema: Object) -> Object:
    """Return a definition of a namespaced kind with one version."""
    head = {"apiVersion": TEXT, "kind": TEXT, "metadata": {"type": "object"}}
    body = {**schema, "type": "object", "properties": {**head, **schema["properties"]}}
    served = {
        "name": version,
        "served": True,
        "storage": True,
        "schema": {"openAPIV3Schema": body},
    }
    return {
        "apiVersion": "apiextensions.k8s.io/v1",
        "kind": "CustomResourceDefinition",
        "metadata": {"name": f"{names['plural']}.{group}"},
        "spec": {"group": group, "scope": "Namespaced", "names": names, "versions": [served]},
    }

"""What Multus and whereabouts may do on the cluster: as little as they need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rigel_k8s.network.multus import RELEASE

Object = dict[str, Any]

#: The names of the two accounts, and of their objects.
MULTUS = "rigel-multus"
WHEREABOUTS = "rigel-whereabouts"

LOOK = ("get", "list", "watch")
WRITE = ("create", "update", "patch", "delete")
RBAC = "rbac.authorization.k8s.io"


def multus_rights() -> tuple[Object, ...]:
    """Return Multus' account: it reads attachments and writes to pods which networks they got."""
    rules = [
        _rule("k8s.cni.cncf.io", ["network-attachment-definitions"], LOOK),
        _rule("", ["pods"], LOOK),
        _rule("", ["pods/status"], ("get", "update", "patch")),
        _rule("", ["events"], ("create", "patch", "update")),
        _rule("events.k8s.io", ["events"], ("create", "patch", "update")),
    ]
    return (_account(MULTUS), *_grant(MULTUS, "Cluster", rules))


def whereabouts_rights() -> tuple[Object, ...]:
    """Return whereabouts' account: it writes its pools, only in its own namespace."""
    kinds = ["ippools", "overlappingrangeipreservations", "nodeslicepools"]
    everywhere = [
        _rule("whereabouts.cni.cncf.io", kinds, LOOK),
        _rule("k8s.cni.cncf.io", ["network-attachment-definitions"], LOOK),
        _rule("", ["pods"], LOOK),
        _rule("", ["nodes"], ("get",)),
        _rule("", ["events"], ("create", "patch", "update")),
        _rule("events.k8s.io", ["events"], ("create", "patch", "update")),
    ]
    own = [
        _rule("whereabouts.cni.cncf.io", kinds, WRITE),
        _rule("coordination.k8s.io", ["leases"], ("get", "create", "update")),
    ]
    return (
        _account(WHEREABOUTS),
        *_grant(WHEREABOUTS, "Cluster", everywhere),
        *_grant(WHEREABOUTS, "", own),
    )


def _rule(group: str, resources: Sequence[str], verbs: Sequence[str]) -> Object:
    return {"apiGroups": [group], "resources": list(resources), "verbs": list(verbs)}


def _account(name: str) -> Object:
    return {
        "apiVersion": "v1",
        "kind": "ServiceAccount",
        "metadata": {"name": name, "namespace": RELEASE.namespace},
    }


def _grant(name: str, scope: str, rules: Sequence[Object]) -> tuple[Object, Object]:
    """Return a role and its binding, for the cluster or (scope "") for the namespace."""
    metadata = {"name": name} | ({} if scope else {"namespace": RELEASE.namespace})
    role = {
        "apiVersion": f"{RBAC}/v1",
        "kind": f"{scope}Role",
        "metadata": metadata,
        "rules": list(rules),
    }
    account = {"kind": "ServiceAccount", "name": name, "namespace": RELEASE.namespace}
    binding = {
        "apiVersion": f"{RBAC}/v1",
        "kind": f"{scope}RoleBinding",
        "metadata": metadata,
        "roleRef": {"apiGroup": RBAC, "kind": f"{scope}Role", "name": name},
        "subjects": [account],
    }
    return role, binding

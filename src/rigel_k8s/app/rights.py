"""Which rights people need: to deploy applications in a namespace, or only to view them.

`rigel rbac` prints them as Roles. A deploy's own check (`release/refusals/rights.py`) tests the
part that this deploy needs, from the same declarations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeAlias

from rigel_k8s.objects.rights import Right, grant
from rigel_k8s.release.refusals.rights import (
    WATCHED,
    need_for_kind,
    need_to_explain,
    need_to_record,
    need_to_wait,
)
from rigel_k8s.release.status import KINDS as SHOWN

RBAC = "rbac.authorization.k8s.io/v1"
Kind: TypeAlias = tuple[str, str]
#: The kinds of objects that an application has in its namespace.
OBJECTS: tuple[Kind, ...] = (
    ("v1", "ConfigMap"),
    ("v1", "Secret"),
    ("v1", "Service"),
    ("v1", "PersistentVolumeClaim"),
    ("apps/v1", "Deployment"),
)
#: Additional ones of roscore's gate.
OF_GATE: tuple[Kind, ...] = (("v1", "ServiceAccount"), (RBAC, "Role"), (RBAC, "RoleBinding"))
#: Those of a second network, and of a network that only the application's own pods may use.
OF_NETWORK: tuple[Kind, ...] = (
    ("k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition"),
    ("networking.k8s.io/v1", "NetworkPolicy"),
)


def need_to_deploy(namespace: str) -> Iterator[Right]:
    """Yield the rights to deploy applications in a namespace, to view and to remove them.

    Commands run in pods (`pods/exec`) show which nodes are connected, and forward ports.
    """
    yield from need_always(namespace)
    yield from need_to_explain(namespace)
    yield from need_to_have((*OBJECTS, *OF_GATE, *OF_NETWORK), namespace)
    yield from need_to_look(namespace)
    yield from grant("", "pods/exec pods/portforward", "get create", namespace)


def need_always(namespace: str) -> Iterator[Right]:
    """Yield the rights that every deploy needs."""
    yield from need_to_record(namespace)
    yield from need_to_wait(namespace)


def need_to_have(kinds: Iterable[Kind], namespace: str) -> Iterator[Right]:
    """Yield the rights to create, update and delete objects of some kinds."""
    for api_version, kind in kinds:
        watch = " watch" if kind in WATCHED else ""
        verbs = f"get list create patch delete{watch}"
        yield from need_for_kind(api_version, kind, namespace, verbs)


def need_to_look(namespace: str) -> Iterator[Right]:
    """Yield the rights to view pods and their state, and to read logs; not Secrets or commands."""
    yield from grant("", "pods/log", "get", namespace)
    yield from grant("", "pods", "list watch", namespace)
    yield from grant("", "events", "list", namespace)
    yield from grant("metrics.k8s.io", "pods", "list", namespace)
    for api_version, kind in SHOWN:
        yield from need_for_kind(api_version, kind, namespace, "list")


def need_to_watch(namespace: str, *, deployer: bool) -> Iterator[Right]:
    """Yield what `rigel ui` needs beyond the others: to see changes as they happen.

    Args:
        deployer: for a user who may see Secrets: the revisions, and who changes the release.
    """
    yield from grant("", "events", "watch", namespace)
    for api_version, kind in SHOWN:
        yield from need_for_kind(api_version, kind, namespace, "watch")
    if deployer:
        yield from grant("", "secrets", "watch", namespace)
        yield from grant("coordination.k8s.io", "leases", "list watch", namespace)

"""Roles for people who deploy, view, or install, as manifests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

from rigel_k8s.app.deploying.target import context_namespace
from rigel_k8s.app.rights import PURPOSES, read_rights
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.objects.rights import make_rules
from rigel_k8s.settings import Settings

#: On a namespace: the level of Pod Security that its pods must pass.
POD_SECURITY = "pod-security.kubernetes.io/enforce"
RBAC = "rbac.authorization.k8s.io"


def subject(kind: Literal["User", "Group"], name: str) -> Manifest:
    """Return a user or a group in the form of a binding."""
    return {"apiGroup": RBAC, "kind": kind, "name": name}


def account(text: str) -> Manifest:
    """Return the service account of NAMESPACE:NAME in the form of a binding.

    Raises:
        UserError: the text is something else.
    """
    namespace, colon, name = text.partition(":")
    if not (namespace and colon and name):
        raise UserError(
            f'"{text}" is not a service account', hint="write NAMESPACE:NAME, as kubectl does"
        )
    return {"kind": "ServiceAccount", "name": name, "namespace": namespace}


def roles(
    settings: Settings, purpose: str, subjects: Sequence[Manifest], *, namespace: str | None = None
) -> list[Manifest]:
    """Return a role, and its bindings if there are subjects.

    Args:
        purpose: deployer, viewer or installer.
        namespace: the role's; None: that of the settings, or of the context.
    """
    where, kind = "", "ClusterRole"
    if purpose != "installer":
        where = namespace or settings.namespace or context_namespace(settings)
        kind = "Role"
    rules = make_rules(read_rights(PURPOSES[purpose], where))
    return list(bind(kind, f"rigel-{purpose}", where, rules, subjects))


def find_open_namespace(settings: Settings, namespace: str | None) -> str | None:
    """Return a namespace whose deployers may run pods as root of a machine, as far as one sees.

    None: it has a Pod Security label that is not `privileged`, or it cannot be read.
    """
    from rigel_k8s.kube import connect

    where = namespace or settings.namespace or context_namespace(settings)
    try:
        with connect(settings) as cluster:
            found = cluster.get(ObjectRef("v1", "Namespace", "", where))
    except RigelK8sError:
        return None
    if found is None:
        return None
    level = (found["metadata"].get("labels") or {}).get(POD_SECURITY, "privileged")
    return where if level == "privileged" else None


def bind(
    kind: str,
    name: str,
    namespace: str,
    rules: Sequence[Manifest],
    subjects: Sequence[Manifest],
) -> Iterator[Manifest]:
    """Yield a role, and a separate binding for each subject, so that no apply ends another's."""
    place = {"namespace": namespace} if namespace else {}
    api = f"{RBAC}/v1"
    yield {
        "apiVersion": api,
        "kind": kind,
        "metadata": {"name": name, **place},
        "rules": list(rules),
    }
    for one in subjects:
        words = (name, one["kind"].lower(), one.get("namespace"), one["name"])
        full = ":".join(filter(None, words))
        yield {
            "apiVersion": api,
            "kind": f"{kind}Binding",
            "metadata": {"name": full.replace("/", "-").replace("%", "-"), **place},
            "roleRef": {"apiGroup": RBAC, "kind": kind, "name": name},
            "subjects": [one],
        }

"""The rights that a deploy needs, declared by what it does to each kind of object; pure.

The check before a deploy is made from them; app/rights.yaml has all that a user may need.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from rigel_k8s.kube.resources import Resource, built_in
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.rights import Right, grant
from rigel_k8s.release.order import WORKLOADS

#: What is done with the objects of a release, at each stage.
LOOK, WAIT, WRITE, PRUNE = "list", "watch", "create patch", "get delete"

#: Kinds that Kubernetes does not have, and that a release may contain: those have no table.
OTHERS = {
    ("k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition"): Resource(
        "network-attachment-definitions", namespaced=True
    ),
}


def need_for_kind(
    api_version: str, kind: str, namespace: str | None, verbs: str
) -> Iterator[Right]:
    """Yield what some verbs on a kind of object need; nothing for an unknown kind."""
    resource = find_resource(api_version, kind)
    if resource is None:
        return
    group = api_version.rpartition("/")[0]
    yield from grant(group, resource.plural, verbs, namespace or "")


def find_resource(api_version: str, kind: str) -> Resource | None:
    """Return the API's name for a kind; None if it is unknown."""
    key = api_version, kind
    return built_in().get(key) or OTHERS.get(key)


def need_for(
    manifests: Iterable[Manifest],
    changing: Iterable[Manifest],
    gone: Iterable[Manifest],
    namespace: str,
    *,
    create_namespace: bool = False,
) -> set[Right]:
    """Return all rights that one deploy needs.

    Args:
        manifests: all of the release.
        changing: those that are written.
        gone: objects that are deleted.
        create_namespace: whether the namespace is created too.
    """
    made = list(manifests)
    needed = {
        *grant("", "namespaces", "get", namespace),
        *grant("", "secrets", "list create patch delete", namespace),  # its revisions
        *grant("coordination.k8s.io", "leases", "get create update patch delete", namespace),
    }
    if any(manifest["kind"] in WORKLOADS for manifest in made):
        needed |= {*grant("", "pods", "list watch", namespace)}
    watched = [manifest for manifest in made if manifest["kind"] in WORKLOADS]
    for verbs, objects in ((LOOK, made), (WAIT, watched), (WRITE, changing), (PRUNE, gone)):
        for kind in {(m["apiVersion"], m["kind"], m["metadata"].get("namespace")) for m in objects}:
            needed |= {*need_for_kind(*kind, verbs)}
    if create_namespace:
        needed |= {*grant("", "namespaces", "create patch")}
    return needed

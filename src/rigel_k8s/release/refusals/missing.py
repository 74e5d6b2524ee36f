"""The rights that a deploy needs and that are missing: all in one error, with a way out.

One SelfSubjectRulesReview lists all rights in a namespace, for the price of a question about one
right. It may be incomplete (an authorizer other than RBAC does not list its rules), so what seems
to be missing is checked one by one before anything is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.answers import find_mappings
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.kube.resources import Resource, built_in
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.rights import Right, describe, find_missing, grant
from rigel_k8s.release.types import WORKLOADS, Desired, ReleaseId

API = "authorization.k8s.io/v1"


def ask_missing(cluster: Cluster, needed: Iterable[Right], namespace: str) -> list[Right]:
    """Return the rights that are missing.

    Raises:
        ClusterError: the cluster does not report what we may do.
    """
    status = cluster.review(API, "SelfSubjectRulesReview", {"namespace": namespace})
    rules = find_mappings(status, "resourceRules")
    missing = find_missing(needed, rules)
    answers = cluster.parallel(lambda right: is_allowed(cluster, right), missing)
    return [right for right, allowed in zip(missing, answers, strict=True) if not allowed]


def is_allowed(cluster: Cluster, right: Right) -> bool:
    resource, _, sub = right.resource.partition("/")
    attributes = {
        "namespace": right.namespace,
        "verb": right.verb,
        "group": right.group,
        "resource": resource,
        "subresource": sub,
    }
    asked = {"resourceAttributes": attributes}
    return bool(cluster.review(API, "SelfSubjectAccessReview", asked).get("allowed"))


def missing_error(missing: Sequence[Right], what: str, hint: str) -> Forbidden:
    """Return the error for rights that are missing, as one list."""
    error = Forbidden(
        f"cannot {what}: {len(missing)} right(s) are missing; nothing was changed",
        hint=hint,
        details=describe(missing),
    )
    error.reason = "Forbidden"
    return error


@contextmanager
def listing_missing_rights(
    cluster: Cluster, desired: Desired, manifests: Sequence[Manifest]
) -> Iterator[None]:
    """Turn the refusal for the first missing right into one for all of them."""
    try:
        yield
    except Forbidden as error:
        if error.ground != "right":
            raise
        needed = need_for(manifests, manifests, (), desired.release.namespace)
        missing = look_for_missing(cluster, needed, desired.release)
        if not missing:
            raise
        raise explain_missing(desired, missing) from error


def look_for_missing(
    cluster: Cluster, needed: Iterable[Right], release: ReleaseId
) -> Sequence[Right]:
    """Return the missing rights; none if the cluster does not report what we may do."""
    try:
        return ask_missing(cluster, needed, release.namespace)
    except ClusterError:
        return []


def explain_missing(desired: Desired, missing: Sequence[Right]) -> Forbidden:
    """Return the error for missing rights, with the known ways out."""
    where = desired.release.namespace
    hint = "; ".join(find_ways_out(desired, missing))
    return missing_error(missing, f"deploy {desired.release.name} to {where}", hint)


def find_ways_out(desired: Desired, missing: Sequence[Right]) -> Iterator[str]:
    """Yield what to do: about rights in the whole cluster, then about those in the namespace.

    The Role that `rigel rbac` prints for deployers grants nothing outside of its namespace.
    """
    where = desired.release.namespace
    kinds = {(right.group, right.resource) for right in missing}
    known = [
        (manifest["metadata"].get("namespace"), desired.remedies[manifest["kind"]])
        for manifest in desired.objects
        if manifest["kind"] in desired.remedies and is_missing(manifest, kinds)
    ]
    outside = dict.fromkeys(remedy for namespace, remedy in known if not namespace)
    if any(right.resource == "namespaces" and not right.namespace for right in missing):
        outside[f"have the namespace created: `kubectl create namespace {where}`"] = None
    yield from outside
    if any(right.namespace for right in missing):
        grant = f"`rigel -n {where} rbac deployer --user YOU | kubectl apply -f -`"
        usual = f"ask an administrator for them: {grant} grants all that deploys need in {where}"
        yield next((remedy for namespace, remedy in known if namespace), usual)
    elif not outside:
        yield "ask an administrator for a ClusterRole that grants them"


def is_missing(manifest: Manifest, kinds: set[tuple[str, str]]) -> bool:
    """Whether a right for an object's kind is among those that are missing."""
    resource = find_resource(manifest["apiVersion"], manifest["kind"])
    group = str(manifest["apiVersion"]).rpartition("/")[0]
    return resource is not None and (group, resource.plural) in kinds


@contextmanager
def naming_remedy(desired: Desired, kind: str) -> Iterator[None]:
    """Add the known way out for a kind of object to the error of a missing right."""
    try:
        yield
    except Forbidden as error:
        if error.ground == "right":
            error.hint = desired.remedies.get(kind, error.hint)
        raise


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

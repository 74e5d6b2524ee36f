"""Finds the observability stack, and reads from its parts through the API server.

So the user's own kubeconfig is enough, and no port is open to others.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from typing import Any
from urllib.parse import urlsplit

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import Cluster, ObjectRef
from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.observability.names import NAMESPACE, RELEASE
from rigel_k8s.release.labelling import NAMESPACE_ANNOTATION
from rigel_k8s.release.revisions import find_last_good
from rigel_k8s.release.types import ReleaseId

HINT = (
    "set `observability: {enabled: true}` in an orchestration job and run `rigel run`; if it is in"
    " a namespace that you may not list, pass -n NAMESPACE"
)


class NoStack(UserError):
    """There is no observability stack, or it does not have the requested part."""


@attrs.frozen
class StackService:
    """A Service of the stack."""

    cluster: Cluster
    namespace: str
    name: str
    port: int
    prefix: str = ""

    def ask(self, path: str, query: Mapping[str, object] | None = None) -> bytes:
        """Return the answer to a GET; raises as Cluster.get_through_proxy."""
        ref = ObjectRef("v1", "Service", self.namespace, self.name)
        return self.cluster.get_through_proxy(ref, self.prefix + path, port=self.port, query=query)


@attrs.frozen
class InstalledStack:
    """A stack's namespace, and the ports of its Services by their names."""

    cluster: Cluster
    namespace: str
    services: Mapping[str, Mapping[str, Any]]

    def part(self, name: str) -> StackService:
        """Return one of its Services, or the existing one that it uses instead.

        Raises:
            NoStack: it has none, or it cannot be reached through the API server.
        """
        if name in self.services:
            port = self.services[name]["spec"]["ports"][0]["port"]
            return StackService(self.cluster, self.namespace, name, port)
        if there := self.existing.get(name):
            return parse_existing(self.cluster, there)
        raise NoStack(
            f"the observability stack in {self.namespace} has no {name.capitalize()}",
            hint=f"set `observability: {{{name}: {{enabled: true}}}}` to deploy it",
        )

    @cached_property
    def existing(self) -> Mapping[str, Mapping[str, Any]]:
        """The existing parts that it uses and that have an address; none if we may not read them.

        They are those of all applications, since all share one stack.
        """
        try:
            last = find_last_good(self.cluster, ReleaseId(self.namespace, RELEASE))
        except Refusal:
            return {}
        existing = last.options.get("existing") if last else None
        named = existing.items() if isinstance(existing, Mapping) else ()
        return {name: one for name, one in named if isinstance(one, Mapping) and one.get("url")}


def choose_service(cluster: Cluster, name: str, observability: Any) -> StackService:
    """Return a part of the stack, or the one that the job names in `existing`.

    Raises:
        NoStack: there is no stack, or the part cannot be reached through the API server.
        Refusal: we may not read it.
    """
    there: Any = getattr(getattr(observability, "existing", None), name, None)
    if getattr(there, "url", None):
        return parse_existing(cluster, attrs.asdict(there))
    return find_stack(cluster).part(name)


def parse_existing(cluster: Cluster, options: Mapping[str, Any]) -> StackService:
    """Return the part that a job names in `existing`.

    Raises:
        NoStack: it cannot be reached through the API server.
    """
    url = str(options["url"])
    if options.get("tenant") or options.get("secret"):
        raise NoStack(f"{url} needs a tenant or a password, which the API server does not pass on")
    # One that pods use: http://NAME.NAMESPACE:PORT.
    parts = urlsplit(url)
    words = (parts.hostname or "").split(".")
    if parts.scheme != "http" or len(words) < 2 or words[2:3] not in ([], ["svc"]):
        raise NoStack(f"{url} is not a Service of the cluster")
    return StackService(
        cluster,
        words[1],
        words[0],
        parts.port or 80,
        parts.path.strip("/") + "/" if parts.path.strip("/") else "",
    )


def find_namespace(cluster: Cluster) -> str | None:
    """Return the namespace of the cluster's stack, None if it has no stack."""
    roles = cluster.list(
        "rbac.authorization.k8s.io/v1", "ClusterRole", labels={RELEASE_LABEL: RELEASE}
    )
    notes = [role["metadata"].get("annotations") or {} for role in roles]
    return min({one.get(NAMESPACE_ANNOTATION, "") for one in notes} - {""}, default=None)


def find_stack(cluster: Cluster, namespace: str | None = None) -> InstalledStack:
    """Return the stack, in one namespace or in any.

    Raises:
        NoStack: there is no stack, or there are several.
        Refusal: we may not read it.
    """
    by_namespace: dict[str, dict[str, Any]] = {}
    for service in services(cluster, namespace):
        meta = service["metadata"]
        by_namespace.setdefault(meta["namespace"], {})[meta["name"]] = service
    if not by_namespace:
        where = f" in the namespace {namespace}" if namespace else " on this cluster"
        with suppress(Refusal):  # one that only uses existing servers has no Service
            bare = find_namespace(cluster)
            if bare and namespace in (None, bare):
                return InstalledStack(cluster, bare, {})
        raise NoStack(f"there is no observability stack{where}", hint=HINT)
    if len(by_namespace) > 1:
        listed = ", ".join(sorted(by_namespace))
        raise NoStack(f"there are several observability stacks: {listed}", hint="pass one with -n")
    ((found, named),) = by_namespace.items()
    return InstalledStack(cluster, found, named)


def services(cluster: Cluster, namespace: str | None) -> list[dict[str, Any]]:
    """Return the stack's Services; without the right to list all, those in the usual namespace."""
    labels = {RELEASE_LABEL: RELEASE}
    try:
        return cluster.list("v1", "Service", namespace, labels=labels)
    except Forbidden:
        if namespace:
            raise
    return cluster.list("v1", "Service", NAMESPACE, labels=labels)


def explain(what: str, error: ClusterError | NoStack) -> str:
    """Return in a few words why a part of the stack was not reached."""
    if not isinstance(error, Refusal):
        return error.message
    if isinstance(error, Forbidden):
        return f"you may not ask {what} (the right `get services/proxy` is missing)"
    if error.status in (0, 500, 502, 503, 504):
        return f"{what} is not ready"
    return f"{what} refuses: {error.message}"

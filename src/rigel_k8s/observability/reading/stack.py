"""Where the observability stack is, and how its parts are asked: through the API server.

So that the user's own kubeconfig is all that is needed: no port is open to anybody else.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any
from urllib.parse import urlsplit

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import Cluster, ObjectRef
from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.observability.installation import find_namespace
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.release.deploy import find_last_good
from rigel_k8s.release.types import ReleaseId

#: Where a stack is looked for by somebody who may not list the Services of all namespaces.
USUAL = "monitoring"
HINT = (
    "`observability: {enabled: true}` in an orchestration job deploys one with the next"
    " `rigel run`; -n NAMESPACE, if it is where you may not look"
)


class NoStack(UserError):
    """There is no observability stack, or it lacks the part that is asked for."""


@attrs.frozen
class StackService:
    """A Service of the stack."""

    cluster: Cluster
    namespace: str
    name: str
    port: int
    prefix: str = ""

    def ask(self, path: str, query: Mapping[str, object] | None = None) -> bytes:
        """Return what it answers to a GET; raises as Cluster.proxied."""
        ref = ObjectRef("v1", "Service", self.namespace, self.name)
        return self.cluster.get_through_proxy(ref, self.prefix + path, port=self.port, query=query)


@attrs.frozen
class InstalledStack:
    """A stack's namespace, and the ports of its Services by their names."""

    cluster: Cluster
    namespace: str
    services: Mapping[str, Mapping[str, Any]]

    def part(self, name: str) -> StackService:
        """Return one of its Services, or what it uses in its stead.

        Raises:
            NoStack: it was deployed without, or it cannot be asked through the API server.
        """
        if name in self.services:
            port = self.services[name]["spec"]["ports"][0]["port"]
            return StackService(self.cluster, self.namespace, name, port)
        if there := self.existing.get(name):
            return parse_existing(self.cluster, there)
        raise NoStack(
            f"the observability stack in {self.namespace} has no {name.capitalize()}",
            hint=f"`observability: {{{name}: {{enabled: true}}}}` deploys it",
        )

    @cached_property
    def existing(self) -> Mapping[str, Mapping[str, Any]]:
        """What it uses that was there before and that has an address; none where we may not look.

        Whichever application has said so: all share one stack.
        """
        try:
            last = find_last_good(self.cluster, ReleaseId(self.namespace, RELEASE))
        except Refusal:
            return {}
        said = last.options.get("existing") if last else None
        named = said.items() if isinstance(said, Mapping) else ()
        return {name: one for name, one in named if isinstance(one, Mapping) and one.get("url")}


def part_of(cluster: Cluster, name: str, observability: Any) -> StackService:
    """Return a part of the stack, or what the job names as there before (`existing`).

    Raises:
        NoStack: there is none, or it cannot be asked through the API server.
        Refusal: nobody may look.
    """
    there: Any = getattr(getattr(observability, "existing", None), name, None)
    if getattr(there, "url", None):
        return parse_existing(cluster, attrs.asdict(there))
    return find_stack(cluster).part(name)


def parse_existing(cluster: Cluster, said: Mapping[str, Any]) -> StackService:
    """Return what a job names as there before.

    Raises:
        NoStack: it cannot be asked through the API server.
    """
    url = str(said["url"])
    if said.get("tenant") or said.get("secret"):
        raise NoStack(f"{url} wants a tenant or a password, which the API server does not pass on")
    return parse_url(cluster, url)


def parse_url(cluster: Cluster, url: str) -> StackService:
    """Return the Service that a URL names as pods do: http://NAME.NAMESPACE:PORT.

    Raises:
        NoStack: it names none.
    """
    said = urlsplit(url)
    words = (said.hostname or "").split(".")
    if said.scheme != "http" or len(words) < 2 or words[2:3] not in ([], ["svc"]):
        raise NoStack(f"{url} is no Service of the cluster")
    return StackService(
        cluster,
        words[1],
        words[0],
        said.port or 80,
        said.path.strip("/") + "/" if said.path.strip("/") else "",
    )


def find_stack(cluster: Cluster, namespace: str | None = None) -> InstalledStack:
    """Return the stack, of one namespace or wherever it is.

    Raises:
        NoStack: there is none, or there are several.
        Refusal: nobody may look.
    """
    by_namespace: dict[str, dict[str, Any]] = {}
    for service in services(cluster, namespace):
        meta = service["metadata"]
        by_namespace.setdefault(meta["namespace"], {})[meta["name"]] = service
    if not by_namespace:
        where = f" in the namespace {namespace}" if namespace else " on this cluster"
        if (bare := find_bare_stack(cluster)) and namespace in (None, bare):
            return InstalledStack(cluster, bare, {})
        raise NoStack(f"there is no observability stack{where}", hint=HINT)
    if len(by_namespace) > 1:
        listed = ", ".join(sorted(by_namespace))
        raise NoStack(f"there are several observability stacks: {listed}", hint="name one with -n")
    ((found, named),) = by_namespace.items()
    return InstalledStack(cluster, found, named)


def find_bare_stack(cluster: Cluster) -> str | None:
    """Return the namespace of a stack whose servers were all there before, None for none."""
    try:
        return find_namespace(cluster)
    except Refusal:
        return None


def services(cluster: Cluster, namespace: str | None) -> list[dict[str, Any]]:
    """Return the stack's Services; who may not look everywhere gets the usual namespace's."""
    labels = {RELEASE_LABEL: RELEASE}
    try:
        return cluster.list("v1", "Service", namespace, labels=labels)
    except Forbidden:
        if namespace:
            raise
    return cluster.list("v1", "Service", USUAL, labels=labels)


def explain(what: str, error: ClusterError | NoStack) -> str:
    """Return in a few words why a part of the stack is not asked."""
    if not isinstance(error, Refusal):
        return error.message
    if isinstance(error, Forbidden):
        return f"you may not ask {what} (the right to get services/proxy)"
    if error.status in (0, 500, 502, 503, 504):
        return f"{what} is not ready"
    return f"{what} refuses: {error.message}"

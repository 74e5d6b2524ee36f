"""`network_policy`: NetworkPolicies that let only a release's own pods reach each other.

They limit connections to the release's pods, never connections from them: DNS, a robot's
own master and the API server stay reachable. A machine always reaches the pods that run on it, so
probes work, and `rigel` connects through the API server and the pod's machine.
"""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.networkpolicy.options import NetworkPolicy, Source
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import selector
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.observability.names import EXPORTER, EXPORTER_PORT, PROMETHEUS

NAMESPACE_LABEL = "kubernetes.io/metadata.name"


def policy_objects(
    around: ReleaseContext, options: NetworkPolicy, *, exporter: bool
) -> Iterator[Object]:
    """Yield the release's policies.

    Args:
        exporter: whether the release has a ROS exporter, which a Prometheus must reach.
    """
    own: Object = {"podSelector": {"matchLabels": {RELEASE_LABEL: around.release}}}
    sources = [own, *(source_of(source) for source in options.allow)]
    yield policy(around, around.release, {RELEASE_LABEL: around.release}, {"from": sources})
    if exporter:
        ports = [{"port": EXPORTER_PORT, "protocol": "TCP"}]
        scraper = {"namespaceSelector": {}, "podSelector": {"matchLabels": selector(PROMETHEUS)}}
        rule = {"from": [scraper], "ports": ports}
        yield policy(
            around,
            f"{around.release}-{EXPORTER}",
            {RELEASE_LABEL: around.release, **selector(EXPORTER)},
            rule,
            part_of=EXPORTER,
        )


def source_of(source: Source) -> Object:
    """Return the peer of a policy that a source names."""
    if source.cidr is not None:
        return {"ipBlock": {"cidr": source.cidr}}
    namespace, _, release = source.rpartition("/")
    peer: Object = {}
    if namespace:
        peer["namespaceSelector"] = {"matchLabels": {NAMESPACE_LABEL: namespace}}
    if release != "*":
        peer["podSelector"] = {"matchLabels": {RELEASE_LABEL: release}}
    return peer


def policy(
    around: ReleaseContext,
    name: str,
    pods: dict[str, str],
    rule: Object,
    part_of: str | None = None,
) -> Object:
    """Return a policy that lets only the sources of one rule connect to some pods."""
    return {
        "apiVersion": "networking.k8s.io/v1",
        "kind": "NetworkPolicy",
        "metadata": around.metadata(name, part_of=part_of),
        "spec": {
            "podSelector": {"matchLabels": pods},
            "policyTypes": ["Ingress"],
            "ingress": [rule],
        },
    }

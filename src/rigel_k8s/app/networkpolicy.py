"""`network_policy`: NetworkPolicies that let only a release's own pods reach each other.

They limit connections to the release's pods, never connections from them: DNS, a robot's
own master and the API server stay reachable. A machine always reaches the pods that run on it, so
probes work, and `rigel` connects through the API server and the pod's machine.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from ipaddress import ip_network

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import selector
from rigel_k8s.objects.podoptions import PortOptions
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.scalars import ObjectName, Port, Text
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.observability.names import EXPORTER, EXPORTER_PORT, PROMETHEUS

NAMESPACE_LABEL = "kubernetes.io/metadata.name"


class Source(Text):
    """What else may reach a release: another release, a namespace, or addresses."""

    kind = "bad-source"
    expects = "RELEASE, NAMESPACE/RELEASE, NAMESPACE/*, or addresses such as 192.168.1.0/24"
    pattern = re.compile(r"[^/\s]+(/[^/\s]+)?")

    @classmethod
    def parse(cls, raw: str) -> Source:
        """Return the source, or raise ValueError with what is expected."""
        value = super().parse(raw)
        if value.cidr is not None:
            return value
        namespace, slash, release = raw.rpartition("/")
        names = [namespace] if slash else []
        names += [] if slash and release == "*" else [release]
        try:
            for name in names:
                ObjectName.parse(name)
        except ValueError:
            raise ValueError(f'"{raw}" is not {cls.expects}') from None
        return value

    @property
    def cidr(self) -> str | None:
        """The range of addresses that it names, None if it names releases."""
        try:
            return str(ip_network(self, strict=False))
        except ValueError:
            return None


@attrs.frozen(kw_only=True)
class NetworkPolicy:
    """What may connect to the release's pods, in addition to the pods themselves."""

    allow: list[Source] = option(
        "others that may connect: RELEASE, NAMESPACE/RELEASE, NAMESPACE/* or a range of addresses",
        [],
    )


def policy_objects(
    release: ReleaseContext,
    options: NetworkPolicy,
    *,
    exporter: bool,
    outside: Mapping[str, tuple[str, Sequence[Port | PortOptions]]],
) -> Iterator[Object]:
    """Yield the release's policies.

    Args:
        exporter: whether the release has a ROS exporter, which a Prometheus must reach.
        outside: nodes that are reached from outside of the cluster, with their workload and ports.
    """
    own: Object = {"podSelector": {"matchLabels": {RELEASE_LABEL: release.release}}}
    sources = [own, *(source_of(source) for source in options.allow)]
    yield policy(release, release.release, {RELEASE_LABEL: release.release}, {"from": sources})
    if exporter:
        ports = [{"port": EXPORTER_PORT, "protocol": "TCP"}]
        scraper = {"namespaceSelector": {}, "podSelector": {"matchLabels": selector(PROMETHEUS)}}
        rule = {"from": [scraper], "ports": ports}
        yield policy(
            release,
            f"{release.release}-{EXPORTER}",
            {RELEASE_LABEL: release.release, **selector(EXPORTER)},
            rule,
            part_of=EXPORTER,
        )
    for name, (workload, opened) in outside.items():
        known = (one if isinstance(one, PortOptions) else PortOptions(port=one) for one in opened)
        rule = {"ports": [{"port": int(one.port), "protocol": one.protocol} for one in known]}
        pods = {RELEASE_LABEL: release.release, **selector(workload)}
        yield policy(release, f"{release.release}-{name}", pods, rule, part_of=workload)


def source_of(source: Source) -> Object:
    """Return the peer of a policy that a source names."""
    if source.cidr is not None:
        return {"ipBlock": {"cidr": source.cidr}}
    namespace, _, name = source.rpartition("/")
    peer: Object = {}
    if namespace:
        peer["namespaceSelector"] = {"matchLabels": {NAMESPACE_LABEL: namespace}}
    if name != "*":
        peer["podSelector"] = {"matchLabels": {RELEASE_LABEL: name}}
    return peer


def policy(
    release: ReleaseContext,
    name: str,
    pods: dict[str, str],
    rule: Object,
    part_of: str | None = None,
) -> Object:
    """Return a policy that lets only the sources of one rule connect to some pods."""
    return {
        "apiVersion": "networking.k8s.io/v1",
        "kind": "NetworkPolicy",
        "metadata": release.metadata(name, part_of=part_of),
        "spec": {
            "podSelector": {"matchLabels": pods},
            "policyTypes": ["Ingress"],
            "ingress": [rule],
        },
    }

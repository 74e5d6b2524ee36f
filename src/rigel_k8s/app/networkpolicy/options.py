"""The option `network_policy`; independent of Kubernetes objects."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

import re
from ipaddress import ip_network

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.scalars import ObjectName, Text


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

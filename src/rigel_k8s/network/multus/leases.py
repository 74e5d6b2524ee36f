"""Pods whose DHCP lease is no longer renewed, since CNI's DHCP daemon lost it when it ended; pure.

Such a pod keeps an address that the network's DHCP server gives to another device one day, and
neither of the two reports it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.network.multus.interfaces import list_asked

Object = Mapping[str, Any]

#: The container of Multus' pods in which the daemon runs.
DHCP_CONTAINER = "dhcp"


@attrs.frozen
class Unkept:
    """A running pod that is older than the DHCP daemon of its machine.

    Attributes:
        networks: those with addresses by DHCP, each NAMESPACE/NAME.
    """

    namespace: str
    pod: str
    node: str
    networks: tuple[str, ...]

    def __str__(self) -> str:
        names = ", ".join(self.networks)
        return (
            f"the DHCP lease of pod {self.namespace}/{self.pod} on {self.node} at {names} is no"
            " longer renewed: the DHCP daemon there started after the pod"
        )


def find_unkept(
    pods: Iterable[Object], daemons: Iterable[Object], attachments: Iterable[Object]
) -> list[Unkept]:
    """Return the running pods whose leases are no longer renewed; a restart gives them new ones.

    Args:
        daemons: Multus' pods; those without a DHCP daemon are ignored.
        attachments: NetworkAttachmentDefinitions.
    """
    by_dhcp = {_key(one) for one in attachments if _uses_dhcp(one)}
    since = {pod["spec"].get("nodeName", ""): _daemon_start(pod) for pod in daemons}
    found = []
    for pod in pods if by_dhcp else ():
        networks = tuple(name for name in list_asked(pod) if name in by_dhcp)
        meta, node = pod["metadata"], pod["spec"].get("nodeName", "")
        started = min(_list_starts(pod), default="")
        running = pod.get("status", {}).get("phase") == "Running"
        if networks and running and started and started < since.get(node, ""):
            found.append(Unkept(meta.get("namespace", "default"), meta["name"], node, networks))
    return found


def _key(attachment: Object) -> str:
    meta = attachment["metadata"]
    return f"{meta['namespace']}/{meta['name']}"


def _uses_dhcp(attachment: Object) -> bool:
    try:
        config = json.loads((attachment.get("spec") or {}).get("config") or "{}")
    except ValueError:
        return False
    plugins = config.get("plugins", [config]) if isinstance(config, dict) else []
    return any((plugin.get("ipam") or {}).get("type") == "dhcp" for plugin in plugins)


def _daemon_start(pod: Object) -> str:
    """Return when a Multus pod's DHCP daemon started, "" if it has none."""
    for one in pod.get("status", {}).get("containerStatuses") or ():
        if one["name"] == DHCP_CONTAINER:
            return str(one.get("state", {}).get("running", {}).get("startedAt", ""))
    return ""


def _list_starts(pod: Object) -> Iterator[str]:
    """Yield when a pod's containers started, as Kubernetes writes it: sortable text.

    The first one starts after the pod got its networks.
    """
    status = pod.get("status", {})
    for kind in ("initContainerStatuses", "containerStatuses"):
        for one in status.get(kind) or ():
            for state in (one.get("state") or {}, one.get("lastState") or {}):
                for detail in state.values():
                    if detail and detail.get("startedAt"):
                        yield str(detail["startedAt"])

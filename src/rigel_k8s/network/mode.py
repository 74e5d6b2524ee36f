"""A network mode with all that differs: other code asks it instead of comparing the mode's name.

Each module of modes/ has one or several; what most of them have in common is the default.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import attrs

from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Problem
from rigel_k8s.ros import Ros


@attrs.frozen
class ModeUse:
    """What a mode is used with.

    Attributes:
        middleware: fastdds, cyclonedds or zenoh; None if the options name none.
    """

    ros: Ros
    distro: str
    middleware: str | None


class Mode(ABC):
    """One way for pods to reach and discover each other.

    Attributes:
        name: the value of `network.mode`.
        keys: the options that only some modes read, this one included.
        with_master: it is for nodes that find each other at a master, too.
        middleware: the only middleware that works with it.
        connects: it lets nodes of different pods discover each other.
        attached: its pods get a second interface from Multus.
        on_machines: it leaves the pod network and needs something of the machines.
        own_domain: it stays on the pod network, where all applications of a cluster could hear each
            other: each release gets a DDS domain of its own.
        lists_peers: its pods have a list of all pods, each by the name of a Service of its own.
        asks_servers: its pods are clients of discovery servers.
        sets_transports: it decides how Fast DDS sends.
        looks_beyond: ROS 2 is configured to discover nodes beyond its own machine.
        domain_bound: why a node in another domain is not discovered, up to the domain; None: by no
            fault of the mode.
        one_pod: why a workload may have no more than one pod.
        participants: how many participants of one pod the others look for; None: all.
        remedy: what to check if machines do not discover each other; None: the network itself.
    """

    name: ClassVar[str]
    keys: ClassVar[frozenset[str]] = frozenset()
    with_master: ClassVar[bool] = False
    middleware: ClassVar[str | None] = None
    connects: ClassVar[bool] = True
    attached: ClassVar[bool] = False
    on_machines: ClassVar[bool] = False
    own_domain: ClassVar[bool] = False
    lists_peers: ClassVar[bool] = False
    asks_servers: ClassVar[bool] = False
    sets_transports: ClassVar[bool] = False
    looks_beyond: ClassVar[bool] = True
    domain_bound: ClassVar[str | None] = None
    one_pod: ClassVar[str | None] = None
    participants: ClassVar[int | None] = None
    remedy: ClassVar[str | None] = None

    @property
    def in_machine_network(self) -> bool:
        """Whether its pods have the machine's own network instead of one of their own."""
        return self.on_machines and not self.attached

    @abstractmethod
    def wire(self, plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
        """Return what it adds to a pod, except ROS' own variables."""

    def objects(self, plan: NetworkPlan, network: Network) -> Iterator[Object]:
        """Yield further objects that it needs on the cluster."""
        return iter(())

    def check(self, network: Network, use: ModeUse) -> Iterator[Problem]:
        """Yield which of its options are missing, and what they cannot be combined with."""
        return iter(())

    def explain_unused(self, network: Network) -> str | None:
        """Return why the options about addresses have no effect, None if they have one."""
        return None

    def services(self, release: str, network: Network, workloads: Sequence[str]) -> Iterable[str]:
        """Return the names of the Services that it makes, which no workload may have."""
        return ()

    def join(self, plan: NetworkPlan, network: Network) -> Mapping[str, Any]:
        """Return how the exporter, a DDS participant but no ROS node, finds the others.

        These are fields of rigel_exporter/config.py.
        """
        return {}

    def join_seen(self, workloads: Iterable[str], servers: Sequence[str]) -> Mapping[str, Any]:
        """Return the same from what pods show.

        Args:
            workloads: those of the pods.
            servers: the discovery servers that a pod asks, which a user may have set without mode.
        """
        return {"mode": "discovery-server", "servers": [*servers]} if servers else {}

    def interface(self, network: Network) -> str | None:
        """Return the only network interface that DDS uses, None for all of them."""
        return None


def mode_path(network: Network) -> tuple[str, ...]:
    """Return the mode's path in the options: that of `network` itself if it is a single word."""
    return ("network",) if network == Network(mode=network.mode) else ("network", "mode")

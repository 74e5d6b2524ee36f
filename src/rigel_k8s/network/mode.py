"""A network mode as one value: other code reads its fields instead of comparing the mode's name.

Each module of modes/ defines one or several of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.generation import Generation
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Problem


@attrs.frozen
class ModeUse:
    """What a mode is used with.

    Attributes:
        middleware: fastdds, cyclonedds or zenoh; None if the options name none.
    """

    ros: Generation
    distro: str
    middleware: str | None


@attrs.frozen(kw_only=True)
class Mode:
    """One way for pods to reach and discover each other.

    Attributes:
        name: the value of `network.mode`.
        wire: what it adds to a pod, except ROS' own variables.
        objects: further objects that it needs on the cluster.
        check: which of its options are missing, and what they cannot be combined with.
        services: the names of the Services that it makes, which no workload may have; called with
            the release, its network, and its workloads' names.
        join: how the exporter, a DDS participant but not a ROS node, finds the others; fields of
            exporter/config.py.
        interface: the only network interface that DDS uses, None for all of them.
        keys: the options that only some modes read, this one included.
        with_master: it is for nodes that find each other at a master, too.
        middleware: the only middleware that works with it.
        attached: its pods get a second interface from Multus.
        on_machines: it leaves the pod network and needs something of the machines.
        own_domain: it stays on the pod network, where all applications of a cluster could hear each
            other: each release gets a DDS domain of its own.
        looks_beyond: ROS 2 is configured to discover nodes beyond its own machine.
        one_pod: why a workload may have no more than one pod.
        participants: how many participants of one pod the others look for; None: all.
    """

    name: str
    wire: Callable[[NetworkPlan, PodIdentity, Network], Wiring]
    objects: Callable[[NetworkPlan, Network], Iterator[Object]] = lambda plan, network: iter(())
    check: Callable[[Network, ModeUse], Iterator[Problem]] = lambda network, use: iter(())
    services: Callable[[str, Network, Sequence[str]], Iterable[str]] = lambda *_: ()
    join: Callable[[NetworkPlan, Network], Mapping[str, Any]] = lambda plan, network: {}
    interface: Callable[[Network], str | None] = lambda network: None
    keys: frozenset[str] = frozenset()
    with_master: bool = False
    middleware: str | None = None
    attached: bool = False
    on_machines: bool = False
    own_domain: bool = False
    looks_beyond: bool = True
    one_pod: str | None = None
    participants: int | None = None

    @property
    def in_machine_network(self) -> bool:
        """Whether its pods have the machine's own network instead of one of their own."""
        return self.on_machines and not self.attached


def mode_path(network: Network) -> tuple[str, ...]:
    """Return the mode's path in the options: that of `network` itself if it is a single word."""
    return ("network",) if network == Network(mode=network.mode) else ("network", "mode")

"""Pods on the network of one machine: they have its address, but usually share no memory.

Fast DDS takes programs of one address for neighbors: they discover each other by UDP, then write
where the other one does not read. So Fast DDS is limited to UDP, unless all have the machine's
/dev/shm; by a variable or, before jazzy, by a profile.
"""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.network.dds import (
    fastdds_profiles,
    fastdds_variables,
    reads_transports,
    transports,
    uses,
)
from rigel_k8s.network.files import files_config, mount_files
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.pods import Object


def wire_neighbor(plan: NetworkPlan, pod: PodIdentity) -> Wiring:
    """Return what a pod on its machine's network gets."""
    if not uses(plan, "fastdds"):
        return Wiring()
    if reads_transports(plan):
        return Wiring(env=transports(plan, pod))
    return attrs.evolve(mount_files(plan), env=fastdds_variables(plan, pod))


def neighbor_files(plan: NetworkPlan) -> Iterator[Object]:
    """Yield the ConfigMap with the profile, if these pods need it."""
    if uses(plan, "fastdds") and not reads_transports(plan):
        yield files_config(plan, fastdds_profiles(plan))

"""Whether a release fits into its namespace's quotas: what is used, what is added, what is freed.

Pure. A dry run of one pod does not see the sum of all, so it is computed here. Only what certainly
cannot become ready is refused: if a number is unknown, the deploy continues.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any

import attrs

from rigel_k8s.objects.quantities import format_quantity, parse_quantity
from rigel_k8s.objects.refs import Manifest, ObjectRef

#: Amounts by the names under which a quota counts them: `pods`, `requests.cpu`, `count/secrets`.
Amounts = Mapping[str, Decimal]
NONE, ONE = Decimal(0), Decimal(1)
#: What quotas count of pods by the name alone.
REQUESTED = ("cpu", "memory", "ephemeral-storage")
#: The old names of `count/...`.
PLAIN = ("services", "secrets", "configmaps", "persistentvolumeclaims", "resourcequotas")


@attrs.frozen
class Change:
    """What a deploy does to one workload or other object, for a quota.

    Attributes:
        added: what the new one takes while it exists.
        freed: what its predecessor has released by then.
        overlap: what one old pod takes, in a roll-out that makes a new pod before it ends an old
            one; empty in every other.
    """

    ref: ObjectRef
    added: Amounts
    freed: Amounts = attrs.field(factory=dict)
    overlap: Amounts = attrs.field(factory=dict)

    def growth(self, resource: str) -> Decimal:
        """How much more of a resource is used after the deploy."""
        return self.added.get(resource, NONE) - self.freed.get(resource, NONE)

    def takes(self, resource: str) -> bool:
        """Whether it takes more of a resource, even for a moment."""
        return self.growth(resource) > 0 or bool(self.overlap.get(resource))


@attrs.frozen
class Excess:
    """A quota that a release exceeds.

    Attributes:
        refs: the objects that take of it.
    """

    quota: str
    resource: str
    hard: str
    used: str
    added: str
    refs: tuple[ObjectRef, ...]


def find_excess(quotas: Iterable[Manifest], changes: Sequence[Change]) -> Iterator[Excess]:
    """Yield the quotas that are exceeded."""
    for quota in filter(counts_all_pods, quotas):
        status = quota.get("status") or {}
        used: Mapping[str, Any] = status.get("used") or {}
        for resource, hard in (status.get("hard") or {}).items():
            more = find_least_growth(changes, resource)
            if resource not in used or more <= 0:
                continue
            if parse_quantity(used[resource]) + more > parse_quantity(hard):
                name, added = str(quota["metadata"]["name"]), format_quantity(more)
                refs = tuple(change.ref for change in changes if change.takes(resource))
                yield Excess(name, resource, str(hard), str(used[resource]), added, refs)


def find_least_growth(changes: Sequence[Change], resource: str) -> Decimal:
    """Return how much more of a resource is used at one moment, whatever the order of roll-outs.

    That is after the deploy, or when the last roll-out of those with an overlap has its last old
    pod beside all of the new ones. Roll-outs that find no room wait for each other: so only one
    overlap counts, the smallest.
    """
    growth = [change.growth(resource) for change in changes]
    overlaps = [value for change in changes if (value := change.overlap.get(resource, NONE))]
    if not overlaps:
        return sum(growth, NONE)
    before = sum(
        value if change.overlap else min(value, NONE)
        for change, value in zip(changes, growth, strict=True)
    )
    return max(sum(growth, NONE), before + min(overlaps))


def counts_all_pods(quota: Manifest) -> bool:
    """Whether a quota counts every pod that runs forever; others are left to Kubernetes."""
    spec = quota.get("spec") or {}
    return not spec.get("scopeSelector") and set(spec.get("scopes") or []) <= {"NotTerminating"}


def amounts_of_pod(pod: Manifest) -> dict[str, Decimal]:
    """Return what a quota counts of one pod.

    Init containers run before the others and one after the other, except those that continue
    beside them.
    """
    spec = pod["spec"]
    result: dict[str, Decimal] = {"pods": ONE, "count/pods": ONE}
    for side in ("requests", "limits"):
        beside: dict[str, Decimal] = defaultdict(Decimal)
        peak: dict[str, Decimal] = {}
        for container in spec.get("initContainers") or []:
            own = read_side(container, side)
            if container.get("restartPolicy") == "Always":
                add(beside, own)
                own = {}
            for name, value in own.items():
                peak[name] = max(peak.get(name, NONE), value + beside.get(name, NONE))
        for container in spec.get("containers") or []:
            add(beside, read_side(container, side))
        add(beside, {k: parse_quantity(v) for k, v in (spec.get("overhead") or {}).items()})
        for name in {*beside, *peak}:
            value = max(beside.get(name, NONE), peak.get(name, NONE))
            result[f"{side}.{name}"] = value
            if side == "requests" and name in REQUESTED:
                result[name] = value
    return result


def read_side(container: Mapping[str, Any], side: str) -> dict[str, Decimal]:
    """Return a container's requests or limits; a missing request is the limit."""
    resources = container.get("resources") or {}
    said = resources.get(side) or {}
    if side == "requests":
        said = {**(resources.get("limits") or {}), **said}
    return {name: parse_quantity(value) for name, value in said.items()}


def add(total: dict[str, Decimal], more: Amounts, times: int = 1) -> None:
    """Add amounts to others."""
    for name, value in more.items():
        total[name] = total.get(name, NONE) + value * times


def amounts_of_object(manifest: Manifest, plural: str) -> dict[str, Decimal]:
    """Return what a quota counts of an object apart from pods."""
    group = manifest["apiVersion"].rpartition("/")[0]
    result = {f"count/{plural}.{group}" if group else f"count/{plural}": ONE}
    if not group and plural in PLAIN:
        result[plural] = ONE
    if manifest["kind"] == "PersistentVolumeClaim":
        asked = ((manifest.get("spec") or {}).get("resources") or {}).get("requests") or {}
        result["requests.storage"] = parse_quantity(asked.get("storage", "0"))
    return result


def amounts_of_workload(workload: Manifest, pod: Manifest | None = None) -> dict[str, Decimal]:
    """Return what a quota counts of all pods of a Deployment.

    Args:
        pod: one of them as the cluster stores it; None: as the template has it.
    """
    total: dict[str, Decimal] = {}
    one = amounts_of_pod(pod or workload["spec"]["template"])
    add(total, one, int(workload["spec"].get("replicas", 1)))
    return total


def makes_new_pod_first(deployment: Manifest) -> bool:
    """Whether a roll-out cannot begin without room for one more pod."""
    strategy = deployment["spec"].get("strategy") or {}
    if strategy.get("type", "RollingUpdate") != "RollingUpdate":
        return False
    unavailable = (strategy.get("rollingUpdate") or {}).get("maxUnavailable", "25%")
    replicas = int(deployment["spec"].get("replicas", 1))
    if isinstance(unavailable, str) and unavailable.endswith("%"):
        return math.floor(Decimal(unavailable[:-1]) * replicas / 100) == 0
    return int(unavailable) == 0

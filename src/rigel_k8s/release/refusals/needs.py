"""What workloads need and the cluster lacks: machines that fit, and objects that they name."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.images import containers
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.resources import format_quantity, parse_quantity
from rigel_k8s.objects.scheduling import find_taints, has_labels, is_chosen, may_run
from rigel_k8s.release.sources import list_variables
from rigel_k8s.release.types import Obstacle

#: ConfigMaps that the cluster puts into each namespace.
EVERYWHERE = ("kube-root-ca.crt", "openshift-service-ca.crt")
STORAGE = "storage.k8s.io/v1"
#: Kinds that a pod's volumes name: the volume's key, the key of the name in it, the kind.
VOLUMES = (
    ("configMap", "name", "ConfigMap"),
    ("secret", "secretName", "Secret"),
    ("persistentVolumeClaim", "claimName", "PersistentVolumeClaim"),
)


def find_needs(
    workloads: Iterable[Manifest], claims: Iterable[Manifest], brought: Iterable[Manifest]
) -> dict[ObjectRef, list[ObjectRef]]:
    """Return what must exist already, each with the objects that need it.

    Args:
        workloads: with pod templates that change.
        claims: new ones.
        brought: all that the release makes.
    """
    found: dict[ObjectRef, list[ObjectRef]] = {}
    for workload in workloads:
        for need in dict.fromkeys(list_named(workload)):
            found.setdefault(need, []).append(ref_of(workload))
    for claim in claims:
        if name := claim["spec"].get("storageClassName"):
            need = ObjectRef(STORAGE, "StorageClass", "", name)
            found.setdefault(need, []).append(ref_of(claim))
    own = {(manifest["kind"], manifest["metadata"]["name"]) for manifest in brought}
    volumes = {
        (manifest.get("spec") or {}).get("storageClassName")
        for manifest in brought
        if manifest["kind"] == "PersistentVolume"
    }
    return {
        need: users
        for need, users in found.items()
        if (need.kind, need.name) not in own
        and need.name not in EVERYWHERE
        and not (need.kind == "StorageClass" and need.name in volumes)
    }


def list_named(workload: Manifest) -> Iterator[ObjectRef]:
    """Yield the objects that a workload's pods cannot start without."""
    namespace = workload["metadata"].get("namespace", "")
    for source, key, kind in list_sources(workload):
        if key in source and not source.get("optional"):
            yield ObjectRef("v1", kind, namespace, source[key])


def list_sources(workload: Manifest) -> Iterator[tuple[Mapping[str, Any], str, str]]:
    """Yield (what names an object, the key of the name, the object's kind)."""
    for volume in workload["spec"]["template"]["spec"].get("volumes") or ():
        for field, key, kind in VOLUMES:
            yield volume.get(field) or {}, key, kind
        for source in (volume.get("projected") or {}).get("sources") or ():
            yield source.get("configMap") or {}, "name", "ConfigMap"
            yield source.get("secret") or {}, "name", "Secret"
    for container in containers(workload):
        for source, kind in list_variables(container):
            yield source, "name", kind


def find_absent(cluster: Cluster, needs: Mapping[ObjectRef, list[ObjectRef]]) -> Iterator[Obstacle]:
    """Yield an obstacle for each object that needs something that does not exist."""

    def is_absent(need: ObjectRef) -> bool:
        try:
            if cluster.get(need) is not None:
                return False
            return need.kind != "StorageClass" or not has_volumes(cluster, need.name)
        except ClusterError:  # we may not see it
            return False

    answers = zip(needs.items(), cluster.parallel(is_absent, list(needs)), strict=True)
    for (need, users), absent in answers:
        if absent:
            where = f" in the namespace {need.namespace}" if need.namespace else ""
            for user in users:
                text = f"the {need.kind} {need.name} does not exist{where}"
                yield Obstacle(user, text, "missing-object")


def has_volumes(cluster: Cluster, storage_class: str) -> bool:
    """Whether volumes of a class exist that was never defined: claims are bound to them by name."""
    volumes = cluster.list("v1", "PersistentVolume")
    return any(volume["spec"].get("storageClassName") == storage_class for volume in volumes)


HOSTNAME = "kubernetes.io/hostname"
SHOWN = 5  # machines in a message
NONE = Decimal(0)


def find_homeless(workloads: Iterable[Manifest], nodes: Sequence[Manifest]) -> Iterator[Obstacle]:
    """Yield why no machine can ever run a workload's pods; nothing if no machine is known."""
    for workload in workloads if nodes else ():
        if workload["kind"] == "DaemonSet" or workload["spec"].get("replicas") == 0:
            continue
        pod = workload["spec"]["template"]["spec"]
        fitting = [node for node in nodes if may_run(pod, node)]
        chosen = [node for node in nodes if is_chosen(pod, node)]
        if fitting:
            text, ground = explain_size(workload, fitting), "no-room"
        elif chosen:
            text, ground = explain_taints(pod, chosen), "taint"
        else:
            text, ground = explain_choice(pod, nodes), "no-machine"
        if text:
            yield Obstacle(ref_of(workload), text, ground)


def explain_choice(pod: Manifest, nodes: Sequence[Manifest]) -> str:
    """Return why no machine is one that a pod may run on, and the way out."""
    if any(has_labels(pod, node) for node in nodes) or not pod.get("nodeSelector"):
        return "no machine of the cluster meets its node affinity, or runs Linux"
    labels: Mapping[str, str] = pod["nodeSelector"]
    listed = ", ".join(f"{key}={value}" for key, value in labels.items())
    names = [(node["metadata"].get("labels") or {}).get(HOSTNAME) for node in nodes]
    host = labels.get(HOSTNAME)
    if host is not None and host not in names:
        way_out = f"its machines are {list_some(sorted(filter(None, names)))}"
        if len(labels) == 1:
            return f"the cluster has no machine {host}; {way_out}"
    else:
        own = " ".join(f"{key}={value}" for key, value in labels.items() if key != HOSTNAME)
        way_out = f"kubectl label node {host or 'NODE'} {own}"
    return f"no machine of the cluster has the labels {listed}; {way_out}"


def explain_taints(pod: Manifest, chosen: Sequence[Manifest]) -> str:
    """Return which taints keep a pod away from all machines that it may otherwise run on."""
    taints = {node["metadata"]["name"]: find_taints(pod, node) for node in chosen}
    listed = [f"{name} ({', '.join(map(write_taint, found))})" for name, found in taints.items()]
    name, found = next(iter(taints.items()))
    if len(taints) == 1:
        text = f"the only machine that it may run on has a taint: {listed[0]}"
    else:
        text = f"all machines that it may run on have taints: {list_some(listed)}"
    return f"{text}; `kubectl taint node {name} {found[0]['key']}-` removes one"


def write_taint(taint: Manifest) -> str:
    """Return a taint as kubectl writes it."""
    value = f"={taint['value']}" if taint.get("value") else ""
    return f"{taint['key']}{value}:{taint.get('effect')}"


def explain_size(workload: Manifest, fitting: Sequence[Manifest]) -> str:
    """Return why one pod of a workload is too large for each machine; "" if it is not."""
    asked = add_requests(workload["spec"]["template"]["spec"])
    rooms = [(node["metadata"]["name"], read_room(node)) for node in fitting]
    if any(not room or holds(room, asked) for _, room in rooms):
        return ""
    for resource, value in asked.items():
        name, room = max(rooms, key=lambda entry: entry[1].get(resource, NONE))
        most = room.get(resource, NONE)
        if most >= value:
            continue
        requested = f"it requests {format_quantity(value)} of {resource}"
        if not most:
            return f"{requested}, which no machine that it may run on has"
        return (
            f"{requested}, and the largest machine that it may run on, {name}, has"
            f" {format_quantity(most)}"
        )
    listed = ", ".join(f"{format_quantity(value)} of {name}" for name, value in asked.items())
    return f"no machine that it may run on has all that it requests: {listed}"


def add_requests(pod: Manifest) -> dict[str, Decimal]:
    """Return what the containers of a pod request at the same time; what is missing is the limit.

    Init containers that end before the others start are left to the scheduler.
    """
    total: dict[str, Decimal] = {}
    stay = [one for one in pod.get("initContainers") or () if one.get("restartPolicy") == "Always"]
    for container in (*stay, *(pod.get("containers") or ())):
        resources = container.get("resources") or {}
        own = {**(resources.get("limits") or {}), **(resources.get("requests") or {})}
        for name, value in own.items():
            total[name] = total.get(name, NONE) + parse_quantity(value)
    return {name: value for name, value in sorted(total.items()) if value}


def holds(room: Mapping[str, Decimal], asked: Mapping[str, Decimal]) -> bool:
    """Whether a machine has all that is requested."""
    return all(room.get(resource, NONE) >= value for resource, value in asked.items())


def read_room(node: Manifest) -> dict[str, Decimal]:
    """Return what a machine has for pods; empty if it is unknown."""
    found = (node.get("status") or {}).get("allocatable") or {}
    return {name: parse_quantity(value) for name, value in found.items()}


def list_some(names: Sequence[str]) -> str:
    """Return names with commas; of many, the first ones and how many more there are."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more

"""What the pods of a release need and the release does not bring: it must exist before.

ConfigMaps, Secrets and claims that containers and volumes name, and the StorageClasses of claims.
Kubernetes accepts a name of nothing, and the pod then waits for it. What must not be read counts as
existing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.images import containers
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
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
#: The same for a container's environment.
ENVIRONMENT = (
    ("configMapRef", "ConfigMap"),
    ("secretRef", "Secret"),
    ("configMapKeyRef", "ConfigMap"),
    ("secretKeyRef", "Secret"),
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
        entries = [
            *(container.get("envFrom") or ()),
            *(one.get("valueFrom") or {} for one in container.get("env") or ()),
        ]
        for entry in entries:
            for field, kind in ENVIRONMENT:
                yield entry.get(field) or {}, "name", kind


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

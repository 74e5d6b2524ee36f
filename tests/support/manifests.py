"""Small manifests of a release `demo` in the namespace `n`, as deploys get them."""

from __future__ import annotations

from typing import Any

from rigel_k8s.objects.marks import FIRST_ANNOTATION, SINGLETON_ANNOTATION
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import Desired, ReleaseId

NAMESPACE = "n"
RELEASE = ReleaseId(NAMESPACE, "demo")
NAME = "app.kubernetes.io/name"
API_VERSIONS = {
    "Deployment": "apps/v1",
    "Job": "batch/v1",
    "Lease": "coordination.k8s.io/v1",
    "StatefulSet": "apps/v1",
    "StorageClass": "storage.k8s.io/v1",
}
CLUSTER_WIDE = ("Namespace", "PersistentVolume", "StorageClass")


def desired(*objects: dict[str, Any], **more: Any) -> Desired:
    return Desired(RELEASE, objects, **more)


def make(kind: str, name: str, **content: Any) -> dict[str, Any]:
    """Return an object of the release's namespace, or of the whole cluster."""
    api_version = ref(kind, name).api_version
    meta = {"name": name} if kind in CLUSTER_WIDE else {"name": name, "namespace": NAMESPACE}
    return {"apiVersion": api_version, "kind": kind, "metadata": meta, **content}


def config(name: str = "c", **data: str) -> dict[str, Any]:
    return make("ConfigMap", name, data=data)


def claim(name: str = "data", **spec: Any) -> dict[str, Any]:
    return make("PersistentVolumeClaim", name, spec=spec)


def workload(
    name: str = "talker",
    image: str = "app:1",
    *,
    first: bool = False,
    singleton: str = "",
    replicas: int = 1,
    **notes: str,
) -> dict[str, Any]:
    """Return a Deployment.

    Args:
        first: whether the others wait for it, as for a ROS master.
        singleton: its ROS name, which only one may have at a time.
        notes: more annotations.
    """
    if first:
        notes[FIRST_ANNOTATION] = "true"
    if singleton:
        notes[SINGLETON_ANNOTATION] = singleton
    labels = {NAME: name, "rigel-k8s/release": "demo"}
    meta: dict[str, Any] = {"name": name, "namespace": NAMESPACE}
    probe = {"exec": {"command": ["true"]}}
    container = {"name": "node", "image": image, "readinessProbe": probe}
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {**meta, "annotations": notes} if notes else meta,
        "spec": {
            "replicas": replicas,
            "strategy": {"type": "Recreate"},
            "selector": {"matchLabels": {NAME: name}},
            "template": {"metadata": {"labels": labels}, "spec": {"containers": [container]}},
        },
    }


def ref(kind: str, name: str) -> ObjectRef:
    """Return the reference of an object of the release's namespace."""
    return ObjectRef(API_VERSIONS.get(kind, "v1"), kind, NAMESPACE, name)

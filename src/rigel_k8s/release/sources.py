"""Secrets and ConfigMaps that nodes read as variables, when they start: those changed since.

Those of a volume are not meant: their files change in the container.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.overlay import containers_of
from rigel_k8s.objects.refs import Manifest, ObjectRef

#: What names them in `env` and `envFrom`, and their kinds.
FIELDS = (
    ("configMapRef", "ConfigMap"),
    ("secretRef", "Secret"),
    ("configMapKeyRef", "ConfigMap"),
    ("secretKeyRef", "Secret"),
)


def find_changed(
    cluster: Cluster,
    workloads: Iterable[Manifest],
    list_pods: Callable[[Manifest], Iterable[Manifest]],
) -> list[str]:
    """Return which nodes run with values that are no longer those, in a sentence for each.

    Without the right to see Secrets, none is reported.

    Args:
        list_pods: returns the pods of a workload's newest template.
    """
    uses = [(live, *use) for live in workloads for use in list_variable_sources(live)]
    refs = sorted({ref for _, _, ref in uses}, key=str)
    changes = cluster.parallel(lambda ref: read_change(cluster, ref), refs)
    times = dict(zip(refs, changes, strict=True))
    found = set()
    for live, container, ref in uses:
        name, start = live["metadata"]["name"], find_start(list_pods(live), container)
        if start and times[ref] > start:
            text = f"{ref.kind} {ref.name} has changed since it started, and it has the old values"
            found.add(f"{name}: {text}: `rigel restart {name}`")
    return sorted(found)


def list_variable_sources(workload: Manifest) -> Iterator[tuple[str, ObjectRef]]:
    """Yield each container of a workload with what it reads as variables."""
    namespace = workload["metadata"]["namespace"]
    for container in containers_of(workload):
        for source, kind in list_variables(container):
            yield container["name"], ObjectRef("v1", kind, namespace, str(source.get("name")))


def list_variables(container: Mapping[str, Any]) -> Iterator[tuple[Mapping[str, Any], str]]:
    """Yield what a container's variables come from, as it is named there, and its kind."""
    entries = [
        *(container.get("envFrom") or ()),
        *(one.get("valueFrom") or {} for one in container.get("env") or ()),
    ]
    for entry in entries:
        for field, kind in FIELDS:
            if source := entry.get(field):
                yield source, kind


def read_change(cluster: Cluster, ref: ObjectRef) -> str:
    """Return when an object was last changed, as Kubernetes writes times; "" if it is not known."""
    try:
        found = cluster.list(
            "v1", ref.kind, ref.namespace, fields=f"metadata.name={ref.name}", metadata_only=True
        )
    except Forbidden:
        return ""
    metas = [one["metadata"] for one in found if one["metadata"]["name"] == ref.name]
    written = [entry for meta in metas for entry in meta.get("managedFields") or ()]
    times = [meta.get("creationTimestamp") for meta in metas]
    times += [entry.get("time") for entry in written if not entry.get("subresource")]
    return max(filter(None, times), default="")


def find_start(pods: Iterable[Manifest], container: str) -> str:
    """Return when a container started in the pod in which it has run the longest, "" if in none."""
    states = (
        (one.get("state") or {}).get("running") or {}
        for pod in pods
        for one in (pod.get("status") or {}).get("containerStatuses") or ()
        if one.get("name") == container
    )
    return min(filter(None, (state.get("startedAt") for state in states)), default="")

"""Pods with several nodes, each in a container of its own: what readers see of each node.

Why one place: logs, status, the graph and all others name nodes. They read each node as if it had
a pod, and a Deployment, of its own; `split` makes these of what is on the cluster.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.overlay import parse_json
from rigel_k8s.objects.refs import Manifest

#: On a Deployment and its pods that have several nodes: the notes of each, by its container.
NODES_ANNOTATION = "rigel-k8s/nodes"
#: On what `split` returns: the name of the Deployment that all nodes of the pod share.
SHARED_ANNOTATION = "rigel-k8s/shared-pod"


def note_nodes(nodes: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the annotation of a pod's nodes: container -> annotations of a pod of its own."""
    return {NODES_ANNOTATION: json.dumps(nodes, sort_keys=True)}


def split_all(items: Iterable[Manifest]) -> Iterator[dict[str, Any]]:
    """Yield what `split` does, of each."""
    for item in items:
        yield from split(item)


def split(item: Manifest) -> Iterator[dict[str, Any]]:
    """Yield a Deployment or a pod as one of each node in it; any other object as it is."""
    meta = item["metadata"]
    nodes: dict[str, Any] = parse_json((meta.get("annotations") or {}).get(NODES_ANNOTATION), {})
    if not nodes or not all(isinstance(notes, dict) for notes in nodes.values()):
        yield dict(item)
        return
    for container, notes in sorted(nodes.items()):
        if item.get("kind") == "Deployment" or "template" in item.get("spec", {}):
            template = item["spec"]["template"]
            inner = {
                **template,
                "metadata": _describe(template.get("metadata") or {}, container, notes),
                "spec": _choose_container(template["spec"], container),
            }
            yield {
                **item,
                "metadata": {**_describe(meta, container, notes), "name": container},
                "spec": {**item["spec"], "template": inner},
            }
        else:
            yield {
                **item,
                "metadata": _describe(meta, container, notes),
                "spec": _choose_container(item["spec"], container),
                "status": _choose_status(item.get("status") or {}, container),
            }


def shared_pod(item: Mapping[str, Any]) -> str:
    """Return the name of the Deployment of what `split` has returned, "" if it is of one node."""
    return str((item["metadata"].get("annotations") or {}).get(SHARED_ANNOTATION, ""))


def _describe(meta: Mapping[str, Any], container: str, notes: Mapping[str, str]) -> dict[str, Any]:
    labels, own = meta.get("labels") or {}, dict(meta.get("annotations") or {})
    own.pop(NODES_ANNOTATION, None)
    own[SHARED_ANNOTATION] = str(labels.get(NAME_LABEL) or meta.get("name", ""))
    own |= {key: str(note) for key, note in notes.items()}  # anyone may have written them
    return {**meta, "labels": {**labels, NAME_LABEL: container}, "annotations": own}


def _choose_container(spec: Mapping[str, Any], container: str) -> dict[str, Any]:
    named = [one for one in spec.get("containers") or [] if one["name"] == container]
    return {**spec, "containers": named or spec.get("containers")}


def _choose_status(status: Mapping[str, Any], container: str) -> dict[str, Any]:
    """Return a pod's status for one of its containers, which is ready without the others."""
    own = [one for one in status.get("containerStatuses") or [] if one["name"] == container]
    made = {**status, "containerStatuses": own}
    conditions = status.get("conditions") or []
    if own and own[0].get("ready") and _waits_for_containers(conditions):
        made["conditions"] = [
            {**one, "status": "True"} if one.get("type") in ("Ready", "ContainersReady") else one
            for one in conditions
        ]
    return made


def _waits_for_containers(conditions: Iterable[Mapping[str, Any]]) -> bool:
    """Whether a pod is not ready only because one of its containers is not."""
    found = {one.get("type"): one for one in conditions}
    return found.get("Ready", {}).get("reason") == "ContainersNotReady"

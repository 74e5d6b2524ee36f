"""What a release requests of the second network: its pods, attachments, possible machines."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.network.preflight.attachments import address
from rigel_k8s.network.preflight.machine import Address
from rigel_k8s.network.wiring import NETWORKS_ANNOTATION

Manifest = Mapping[str, Any]

#: ROS images are Linux'.
SYSTEM = "kubernetes.io/os"

#: Taints that come and go with a machine's state: its pods wait for it.
PASSING = ("node.kubernetes.io/not-ready", "node.kubernetes.io/unreachable")


@attrs.frozen
class Request:
    """One attachment that a pod requests: NAMESPACE/NAME, and addresses if it requests them."""

    key: str
    addresses: tuple[Address, ...] = ()


@attrs.frozen
class Wanted:
    """A workload whose pods request second networks.

    Attributes:
        pods: how many of them.
        labels: of the pods, for policies that select them.
        spec: the pods' spec, which decides where they may run.
    """

    workload: str
    namespace: str
    requests: tuple[Request, ...]
    pods: int = 1
    labels: Mapping[str, str] = attrs.field(factory=dict)
    spec: Manifest = attrs.field(factory=dict)

    def requests_network(self, key: str) -> bool:
        """Return whether its pods request this attachment."""
        return any(request.key == key for request in self.requests)


def find_wanted(objects: Iterable[Manifest]) -> Iterator[Wanted]:
    """Yield the workloads that request an attachment, or the machine's own network."""
    for item in objects:
        spec = item.get("spec") or {}
        template = spec.get("template") or {}
        meta, pod = template.get("metadata") or {}, template.get("spec") or {}
        namespace = item["metadata"].get("namespace", "")
        asked = tuple(requests(meta.get("annotations") or {}, namespace))
        if asked or pod.get("hostNetwork"):
            replicas = spec.get("replicas")
            yield Wanted(
                item["metadata"]["name"],
                namespace,
                asked,
                pods=1 if replicas is None else int(replicas),
                labels=meta.get("labels") or {},
                spec=pod,
            )


def requests(annotations: Mapping[str, str], namespace: str) -> Iterator[Request]:
    """Yield the requests in a pod's annotation, in either of its forms."""
    text = (annotations.get(NETWORKS_ANNOTATION) or "").strip()
    if not text.startswith("["):
        for word in filter(None, (part.strip() for part in text.split(","))):
            yield Request(_key(word.partition("@")[0], namespace))
        return
    for item in _items(text):
        found = [address(one) for one in item.get("ips") or []]
        own = str(item.get("namespace") or namespace)
        addresses = tuple(one for one in found if one is not None)
        yield Request(_key(str(item.get("name", "")), own), addresses)


def _key(name: str, namespace: str) -> str:
    return name if "/" in name else f"{namespace}/{name}"


def _items(text: str) -> list[Mapping[str, Any]]:
    try:
        read = json.loads(text)
    except ValueError:
        return []
    return [item for item in read if isinstance(item, dict)]


def may_run(pod: Manifest, node: Manifest) -> bool:
    """Return whether the scheduler may put a pod (its spec) on a machine, if that were ready."""
    labels = node["metadata"].get("labels") or {}
    name = node["metadata"]["name"]
    if labels.get(SYSTEM, "linux") != "linux":
        return False
    if pod.get("nodeName"):
        return bool(pod["nodeName"] == name)
    chosen = pod.get("nodeSelector") or {}
    return (
        chosen.items() <= labels.items()
        and _has_affinity(pod, labels, name)
        and all(
            _is_tolerated(taint, pod.get("tolerations") or [])
            for taint in (node.get("spec") or {}).get("taints") or []
        )
    )


def _has_affinity(pod: Manifest, labels: Mapping[str, str], name: str) -> bool:
    affinity = (pod.get("affinity") or {}).get("nodeAffinity") or {}
    required = affinity.get("requiredDuringSchedulingIgnoredDuringExecution")
    if not required:
        return True
    return any(_meets(term, labels, name) for term in required.get("nodeSelectorTerms") or [])


def _meets(term: Manifest, labels: Mapping[str, str], name: str) -> bool:
    fields = {"metadata.name": name}
    return all(_holds(one, labels) for one in term.get("matchExpressions") or []) and all(
        _holds(one, fields) for one in term.get("matchFields") or []
    )


def _holds(rule: Manifest, labels: Mapping[str, str]) -> bool:
    """Return whether labels match one expression of a selector."""
    value, values = labels.get(rule["key"]), rule.get("values") or []
    if rule["operator"] in ("In", "NotIn"):
        return (value in values) is (rule["operator"] == "In")
    if rule["operator"] in ("Exists", "DoesNotExist"):
        return (value is not None) is (rule["operator"] == "Exists")
    if value is None or not value.lstrip("-").isdigit():
        return False
    difference = int(value) - int(values[0])
    return difference > 0 if rule["operator"] == "Gt" else difference < 0


def _is_tolerated(taint: Manifest, tolerations: Sequence[Manifest]) -> bool:
    if taint.get("effect") == "PreferNoSchedule" or taint["key"] in PASSING:
        return True
    return any(_tolerates(one, taint) for one in tolerations)


def _tolerates(one: Manifest, taint: Manifest) -> bool:
    if one.get("effect") and one["effect"] != taint.get("effect"):
        return False
    if one.get("operator") == "Exists":
        return not one.get("key") or bool(one["key"] == taint["key"])
    same = one.get("key") == taint["key"] and one.get("value", "") == taint.get("value", "")
    return bool(same)


def is_selected(selector: Manifest, labels: Mapping[str, str]) -> bool:
    """Return whether a label selector, such as a policy's, selects a pod with these labels."""
    return (selector.get("matchLabels") or {}).items() <= labels.items() and all(
        _holds(rule, labels) for rule in selector.get("matchExpressions") or []
    )

"""Which machines may run a pod, as the scheduler decides it; pure, on plain objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rigel_k8s.objects.refs import Manifest

#: ROS images are Linux'.
SYSTEM = "kubernetes.io/os"

#: Taints that come and go with a machine's state: its pods wait for it.
PASSING = tuple(
    f"node.kubernetes.io/{state}"
    for state in (
        "not-ready",
        "unreachable",
        "memory-pressure",
        "disk-pressure",
        "pid-pressure",
        "network-unavailable",
    )
)


def may_run(pod: Manifest, node: Manifest) -> bool:
    """Return whether the scheduler may put a pod (its spec) on a machine, if that were ready."""
    return is_chosen(pod, node) and not find_taints(pod, node)


def is_chosen(pod: Manifest, node: Manifest) -> bool:
    """Return whether a pod's name, labels and affinity allow a machine; its taints may not."""
    labels = node["metadata"].get("labels") or {}
    name = node["metadata"]["name"]
    if labels.get(SYSTEM, "linux") != "linux":
        return False
    if pod.get("nodeName"):
        return bool(pod["nodeName"] == name)
    return has_labels(pod, node) and _has_affinity(pod, labels, name)


def has_labels(pod: Manifest, node: Manifest) -> bool:
    """Return whether a machine has the labels that a pod selects."""
    labels: Mapping[str, str] = node["metadata"].get("labels") or {}
    return bool((pod.get("nodeSelector") or {}).items() <= labels.items())


def find_taints(pod: Manifest, node: Manifest) -> list[Manifest]:
    """Return the taints of a machine that keep a pod away."""
    if pod.get("nodeName"):  # it passes by the scheduler
        return []
    tolerations = pod.get("tolerations") or []
    taints = (node.get("spec") or {}).get("taints") or []
    return [taint for taint in taints if not _is_tolerated(taint, tolerations)]


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


def _is_tolerated(taint: Manifest, tolerations: Iterable[Manifest]) -> bool:
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

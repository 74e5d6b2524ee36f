"""Which pods restart when something that they have read at their start changes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence

from rigel_k8s.app.generations.ros1.globalparameters import PARAMETERS_ANNOTATION
from rigel_k8s.objects.naming import ROS_ANNOTATION
from rigel_k8s.objects.overlay import merge
from rigel_k8s.objects.pods import GATE_CONTAINER, MASTER_NAME
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.observability.names import EXPORTER

#: On the pods of ROS nodes: which roscore they register with.
MASTER_ANNOTATION = "rigel-k8s/master"


def bind(made: Sequence[Manifest]) -> Sequence[Manifest]:
    """Return the objects; the pods of nodes are marked with the roscore that they know.

    A changed roscore restarts without any registrations, and no node registers again. So its nodes
    must restart too, after it: a hash of its pod template is in theirs. A roscore behind a gate
    gets its registrations back from the gate. Nodes restart if the global parameters change, too,
    which they read.
    """
    notes: dict[str, str] = {}
    masters = [item for item in made if is_master(item) and not is_gated(item)]
    if masters:
        text = json.dumps([item["spec"]["template"] for item in masters], sort_keys=True)
        notes[MASTER_ANNOTATION] = hashlib.sha256(text.encode()).hexdigest()[:12]
    for item in made:
        meta = item.get("spec", {}).get("template", {}).get("metadata", {})
        if mark := meta.get("annotations", {}).get(PARAMETERS_ANNOTATION):
            notes[PARAMETERS_ANNOTATION] = mark
    over = {"spec": {"template": {"metadata": {"annotations": notes}}}}
    return tuple(merge(item, over) if notes and has_nodes(item) else item for item in made)


def has_nodes(item: Manifest) -> bool:
    """Return whether an object's pods have ROS nodes that keep one master for their whole life.

    The exporter registers again automatically, and would forget that there was another roscore.
    """
    without_ros = item["metadata"].get("annotations", {}).get(ROS_ANNOTATION) == "none"
    stays = is_master(item) or item["metadata"]["name"] == EXPORTER or without_ros
    return bool(item["kind"] == "Deployment" and not stays)


def is_master(item: Manifest) -> bool:
    """Return whether an object is our roscore."""
    return bool(item["kind"] == "Deployment" and item["metadata"]["name"] == MASTER_NAME)


def is_gated(master: Manifest) -> bool:
    """Return whether a roscore is behind a gate."""
    containers = master["spec"]["template"]["spec"]["containers"]
    return any(one["name"] == GATE_CONTAINER for one in containers)

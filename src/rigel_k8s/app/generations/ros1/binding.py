"""Which pods restart when something that they have read at their start changes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence

from rigel_k8s.app.generations.ros1.globalparameters import PARAMETERS_ANNOTATION
from rigel_k8s.objects.naming import ROS_ANNOTATION
from rigel_k8s.objects.overlay import merge
from rigel_k8s.objects.pods import GATE_CONTAINER, MASTER_NAME
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.observability.names import EXPORTER

#: On the pods of ROS nodes: which roscore they register with.
MASTER_ANNOTATION = "rigel-k8s/master"


def bind_to_master(made: Sequence[Manifest]) -> Iterator[Manifest]:
    """Yield the objects; the pods of all nodes are bound to the roscore that they register with.

    A changed roscore restarts without any registrations, and no node registers again. So its nodes
    must restart too, after it: a hash of its pod template is in theirs. A roscore behind a gate
    gets its registrations back from the gate.
    """
    masters = [item for item in made if is_master(item) and not is_gated(item)]
    text = json.dumps([item["spec"]["template"] for item in masters], sort_keys=True)
    mark = {MASTER_ANNOTATION: hashlib.sha256(text.encode()).hexdigest()[:12]}
    return annotate_nodes(made, mark if masters else {})


def bind_to_parameters(made: Sequence[Manifest]) -> Iterator[Manifest]:
    """Yield the objects; nodes restart if the global parameters change, which they read."""
    notes = [notes_of_pods(item) for item in made]
    setters = [one[PARAMETERS_ANNOTATION] for one in notes if PARAMETERS_ANNOTATION in one]
    return annotate_nodes(made, {PARAMETERS_ANNOTATION: setters[0]} if setters else {})


def annotate_nodes(made: Sequence[Manifest], notes: Mapping[str, str]) -> Iterator[Manifest]:
    """Yield the objects; the pods of all ROS nodes get annotations."""
    over = {"spec": {"template": {"metadata": {"annotations": dict(notes)}}}}
    for item in made:
        yield merge(item, over) if notes and has_nodes(item) else item


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


def notes_of_pods(item: Manifest) -> Mapping[str, str]:
    """Return the annotations of an object's pods."""
    template = item.get("spec", {}).get("template", {})
    notes: Mapping[str, str] = template.get("metadata", {}).get("annotations", {})
    return notes

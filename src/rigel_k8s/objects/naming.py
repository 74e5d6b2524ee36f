"""ROS names to Kubernetes names, and the labels that every object of a release carries."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping

from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL

#: Of a machine: its name.
HOSTNAME = "kubernetes.io/hostname"
#: On a Deployment and its pods: the name of the ROS node in them; of a launch file on pods alone.
ROS_NAME_ANNOTATION = "rigel-k8s/ros-name"
#: On a Deployment and its pods: their key in `nodes`.
NODE_ANNOTATION = "rigel-k8s/node"
#: "none" on the pods of a program without ROS beside ROS nodes.
ROS_ANNOTATION = "rigel-k8s/ros"
#: The maximum length of a label value, and so of a Kubernetes name here.
LONGEST = 63


def denies_ros(annotations: Mapping[str, str] | None) -> bool:
    """Whether a pod, by its annotations, runs a program without ROS beside ROS nodes."""
    return (annotations or {}).get(ROS_ANNOTATION) == "none"


def ros_name(name: str, namespace: str | None = None) -> str:
    """Return the full ROS name, /NAMESPACE/NAME; one that begins with / is full already."""
    if name.startswith("/"):
        return name
    return "/" + "/".join(part for part in ((namespace or "").strip("/"), name) if part)


def object_name(name: str) -> str:
    """Return the Kubernetes name of a ROS name: lower case, "-" for "/" and "_".

    Two ROS names may give the same Kubernetes name (`a_b`, `a/b`); callers must check that.
    A name that would be too long is cut and gets a hash.
    """
    text = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "node"
    if text[0].isdigit():
        text = f"n{text}"  # a Service's name begins with a letter
    if len(text) <= LONGEST:
        return text
    digest = hashlib.sha256(name.encode()).hexdigest()[:8]
    return f"{text[: LONGEST - 9].rstrip('-')}-{digest}"


def selector(name: str) -> dict[str, str]:
    """Return the labels that select a workload's pods."""
    return {NAME_LABEL: name}


def labels(name: str, release: str) -> dict[str, str]:
    """Return the labels of an object and of its pods."""
    return {
        **selector(name),
        "app.kubernetes.io/part-of": release,
        "app.kubernetes.io/managed-by": "rigel",
        RELEASE_LABEL: release,
    }

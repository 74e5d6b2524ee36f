"""The frame that all Deployments and Services of a release share."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.objects.naming import labels, selector
from rigel_k8s.objects.podoptions import Readiness
from rigel_k8s.objects.pods import Object, drop_empty, inpod_volume, log_volume
from rigel_k8s.ros import Ros


@attrs.frozen
class ReleaseContext:
    """What is the same for all objects of a release.

    Attributes:
        distro: the ROS distribution, which decides the default image.
        pull_secrets: names of Secrets with registry credentials.
        master_uri: ROS_MASTER_URI of all nodes; None leaves it to the images.
        gate: whether the release's roscore is behind a gate.
        layer: whether there is a library for ROS 2's processes.
    """

    namespace: str
    release: str
    distro: str
    ros: Ros
    pull_secrets: Sequence[str] = ()
    master_uri: str | None = None
    gate: bool = False
    layer: bool = False

    @property
    def default_image(self) -> str:
        """The image of roscore, and the default of the application."""
        return f"ros:{self.distro}-ros-core"

    def metadata(
        self, name: str, annotations: Mapping[str, str] | None = None, part_of: str | None = None
    ) -> Object:
        """Return an object's metadata; a part of a workload has its label."""
        return drop_empty(
            {
                "name": name,
                "namespace": self.namespace,
                "labels": labels(part_of or name, self.release),
                "annotations": dict(annotations or {}),
            }
        )


def deployment(
    release: ReleaseContext,
    name: str,
    pod: Mapping[str, Any],
    *,
    strategy: Object,
    replicas: int | None = None,
    annotations: Mapping[str, str] | None = None,
    pod_annotations: Mapping[str, str] | None = None,
    own_labels: Mapping[str, str] | None = None,
) -> Object:
    """Return a Deployment; `replicas` is left out unless it is set.

    Args:
        own_labels: the user's, on the Deployment and its pods; not in the selector.
    """
    secrets = [{"name": secret} for secret in release.pull_secrets]
    both = labels(name, release.release) | dict(own_labels or {})
    # The last lines of a crashed container's log are in its pod's status.
    last_words = {"terminationMessagePolicy": "FallbackToLogsOnError"}
    pod = {**pod, "containers": [{**last_words, **one} for one in pod.get("containers", ())]}
    template = {
        "metadata": drop_empty({"labels": both, "annotations": dict(pod_annotations or {})}),
        "spec": {
            **drop_empty({**pod, "imagePullSecrets": secrets}),
            # Kubernetes' variables for Services would fill the environment with ROS_MASTER_PORT ...
            "enableServiceLinks": False,
        },
    }
    spec: Object = {"selector": {"matchLabels": selector(name)}, "strategy": strategy}
    if replicas is not None:
        spec["replicas"] = replicas
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": release.metadata(name, annotations) | {"labels": both},
        "spec": {**spec, "template": template},
    }


def run_once(made: Mapping[str, Any], *, suspend: bool) -> Object:
    """Return the Job that runs the pod of a Deployment once: one that fails is not replaced.

    Args:
        suspend: it has no pod.
    """
    template = made["spec"]["template"]
    once = {**template, "spec": {**template["spec"], "restartPolicy": "Never"}}
    asleep = {"suspend": True} if suspend else {}
    spec = {"backoffLimit": 0, **asleep, "template": once}
    return {**made, "apiVersion": "batch/v1", "kind": "Job", "spec": spec}


def service(
    release: ReleaseContext,
    name: str,
    ports: Sequence[Object],
    workload: str | None = None,
    kind: str | None = None,
) -> Object:
    """Return the Service of a workload's name, or of a node's in its pods.

    Args:
        kind: its type; None for Kubernetes' default.
    """
    chosen = {"type": kind} if kind else {}
    return {
        "apiVersion": "v1",
        "kind": "Service",
        "metadata": release.metadata(name, part_of=workload),
        "spec": {**chosen, "selector": selector(workload or name), "ports": list(ports)},
    }


def config_map(
    release: ReleaseContext,
    name: str,
    data: Mapping[str, str],
    *,
    part_of: str,
    binary: Mapping[str, bytes] | None = None,
) -> Object:
    """Return a ConfigMap of texts, and of other files; its name may be too long for a label."""
    encoded = {key: base64.b64encode(content).decode() for key, content in (binary or {}).items()}
    return {
        "apiVersion": "v1",
        "kind": "ConfigMap",
        "metadata": release.metadata(name, part_of=part_of),
        "data": dict(data),
        **({"binaryData": encoded} if encoded else {}),
    }


def pull_policy(asked: str | None, *, pinned: bool) -> str | None:
    """Return imagePullPolicy: a robot without a network restarts with the image that it has."""
    return asked or ("IfNotPresent" if pinned else None)


def readiness_of(release: ReleaseContext, asked: Readiness | str | None) -> Readiness | str | None:
    """Return what makes a pod ready; an image without ROS may have no Python for our probes."""
    return asked or release.ros.readiness


def ros_volumes(release: ReleaseContext) -> list[tuple[Object, Object]]:
    """Return (volume, mount) of what is ours in each pod."""
    return [inpod_volume(release.release), *([log_volume()] if release.ros.logs else [])]

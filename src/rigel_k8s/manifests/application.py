"""The one application of the peer's keys: a Deployment of the release's name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.manifests.options import OrchestrationOptions
from rigel_k8s.manifests.overlay import merge
from rigel_k8s.manifests.placing import remote_selector, tolerations
from rigel_k8s.manifests.pods import (
    Object,
    compact,
    environment,
    inpod_volume,
    probes,
    stop_hook,
)
from rigel_k8s.manifests.storage import mount_path, volume_source
from rigel_k8s.manifests.updating import strategy
from rigel_k8s.manifests.workloads import Surroundings, deployment, pull_policy

__all__ = ["APP_CONTAINER", "application_deployment", "has_application", "replaces_container"]

APP_CONTAINER = "ros-app"


def has_application(options: OrchestrationOptions) -> bool:
    """Return whether there is an application besides `nodes`."""
    return bool(options.application_image or options.additional_k8s_params.application)


def application_deployment(around: Surroundings, options: OrchestrationOptions) -> Object:
    """Return the application's Deployment with the user's own parts laid over it."""
    selector = remote_selector(options.distributed)
    volumes = options.persistent_storage.volumes
    scripts, _ = inpod_volume(around.release)
    params = options.additional_k8s_params.application
    own = [] if replaces_container(options) else [container(around, options)]
    pod = {
        "containers": own,
        "volumes": [scripts, *(volume_source(volume) for volume in volumes)],
        "nodeSelector": selector,
        "tolerations": tolerations([], pinned=bool(selector)),
    }
    made = deployment(
        around,
        str(options.deployment_name),
        pod,
        strategy=strategy(options.rolling_update, anonymous=False),
        pod_annotations={"kubectl.kubernetes.io/default-container": APP_CONTAINER} if own else {},
    )
    merged: Object = merge(made, params)
    return merged


def container(around: Surroundings, options: OrchestrationOptions) -> Object:
    """Return the application's container."""
    pinned = bool(remote_selector(options.distributed))
    _, scripts = inpod_volume(around.release)
    mounts = [
        {"name": str(volume.name), "mountPath": mount_path(volume)}
        for volume in options.persistent_storage.volumes
    ]
    readiness = options.readiness if around.ros1 else options.readiness or "none"
    return compact(
        {
            "name": APP_CONTAINER,
            "image": str(options.application_image or around.default_image),
            "imagePullPolicy": pull_policy(None, pinned=pinned),
            "env": environment(around.master_uri),
            **probes(readiness),
            "lifecycle": stop_hook(),
            "volumeMounts": [scripts, *mounts],
        }
    )


def replaces_container(options: OrchestrationOptions) -> bool:
    """Return whether the user's containers are all there is: no image, and none called ros-app."""
    names = [c.get("name") for c in containers_of(options.additional_k8s_params.application)]
    return bool(names) and APP_CONTAINER not in names and options.application_image is None


def containers_of(params: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the containers that the user wrote over a Deployment."""
    place: Any = params
    for key in ("spec", "template", "spec", "containers"):
        place = place.get(key) if isinstance(place, Mapping) else None
    return [c for c in place if isinstance(c, Mapping)] if isinstance(place, list) else []

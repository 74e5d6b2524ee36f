"""The one application of src.plugin's keys: a Deployment of the release's name."""

from __future__ import annotations

from collections.abc import Sequence

from rigel_k8s.app.environment import environment, ros_variables
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.placing import remote_selector
from rigel_k8s.app.storage import mount_path, volume_source
from rigel_k8s.app.updating import Way, choose_way, find_application_obstacle
from rigel_k8s.network.wiring import PodIdentity, Wiring
from rigel_k8s.objects.overlay import merge
from rigel_k8s.objects.pods import Object, drop_empty, probes, stop_hook
from rigel_k8s.objects.raw import containers_of
from rigel_k8s.objects.tolerations import tolerations
from rigel_k8s.objects.workloads import (
    ReleaseContext,
    deployment,
    pull_policy,
    readiness_of,
    ros_volumes,
)

APP_CONTAINER = "ros-app"


def has_application(options: OrchestrationOptions) -> bool:
    """Return whether there is an application in addition to `nodes`."""
    return bool(options.application_image or options.additional_k8s_params.application)


def application_identity(around: ReleaseContext, options: OrchestrationOptions) -> PodIdentity:
    """Return the application's identity on the network."""
    image = str(options.application_image or around.default_image)
    policy = pull_policy(None, pinned=bool(remote_selector(options.distributed)))
    return PodIdentity(
        str(options.deployment_name), image, like=drop_empty({"imagePullPolicy": policy})
    )


def application_deployment(
    around: ReleaseContext, options: OrchestrationOptions, wired: Wiring, asked: Sequence[str]
) -> Object:
    """Return the application's Deployment with the user's own parts merged in.

    Args:
        wired: what the network adds.
        asked: what the readiness probe checks by default.
    """
    selector = remote_selector(options.distributed)
    volumes = options.persistent_storage.volumes
    params = options.additional_k8s_params.application
    seen = [mount for _, mount in ros_volumes(around)]
    way = way_of(around, options, wired)
    own = []
    if not replaces_container(options):
        own = [container(around, options, wired, way, asked, seen)]
    pod = {
        "initContainers": list(wired.init_containers) if own else [],
        "containers": own,
        "volumes": [
            *(volume for volume, _ in ros_volumes(around)),
            *(volume_source(volume) for volume in volumes),
            *wired.volumes,
        ],
        "nodeSelector": selector,
        "tolerations": tolerations([], pinned=bool(selector)),
        **wired.pod,
    }
    default = {"kubectl.kubernetes.io/default-container": APP_CONTAINER} if own else {}
    made = deployment(
        around,
        str(options.deployment_name),
        pod,
        strategy=way.strategy,
        annotations=way.annotations(around),
        pod_annotations={**default, **wired.annotations},
    )
    merged: Object = merge(made, params)
    return merged


def way_of(around: ReleaseContext, options: OrchestrationOptions, wired: Wiring) -> Way:
    """Return how the application is updated."""
    obstacle = find_application_obstacle(
        options.readiness,
        options.persistent_storage.volumes,
        options.additional_k8s_params.application,
        own_master="ROS_MASTER_URI" in wired.env,
    )
    if replaces_container(options):
        obstacle = "its containers are the user's own"
    return choose_way(around, str(options.deployment_name), None, options.rolling_update, obstacle)


def container(
    around: ReleaseContext,
    options: OrchestrationOptions,
    wired: Wiring,
    way: Way,
    asked: Sequence[str],
    ros_mounts: Sequence[Object],
) -> Object:
    """Return the application's container."""
    identity = application_identity(around, options)
    mounts = [
        {"name": str(volume.name), "mountPath": mount_path(volume)}
        for volume in options.persistent_storage.volumes
    ]
    return drop_empty(
        {
            "name": APP_CONTAINER,
            "image": identity.image,
            **identity.like,
            "env": environment(ros_variables(around), {**wired.env, **way.env}),
            **probes(readiness_of(around, options.readiness), asked),
            "lifecycle": stop_hook(),
            "volumeMounts": [*ros_mounts, *mounts, *wired.mounts],
        }
    )


def replaces_container(options: OrchestrationOptions) -> bool:
    """Return whether the pod has only the user's containers: no image, and none called ros-app."""
    names = [c.get("name") for c in containers_of(options.additional_k8s_params.application)]
    return bool(names) and APP_CONTAINER not in names and options.application_image is None

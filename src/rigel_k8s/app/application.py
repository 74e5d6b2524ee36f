"""The one application of src.plugin's keys as a node: a Deployment of the release's name."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.app.options import Distributed, NodeOptions, OrchestrationOptions
from rigel_k8s.objects.podoptions import Placement
from rigel_k8s.objects.raw import containers_of
from rigel_k8s.objects.scalars import LabelKey, LabelValue

APP_CONTAINER = "ros-app"
#: The label of remote machines, as in src.plugin.
REMOTE: Mapping[str, str] = {"deploymentType": "remote"}


def has_application(options: OrchestrationOptions) -> bool:
    """Return whether there is an application in addition to `nodes`."""
    return bool(options.application_image or options.additional_k8s_params.application)


def application_options(options: OrchestrationOptions) -> NodeOptions:
    """Return the application's keys as those of a node, which runs the image's CMD."""
    labels = remote_selector(options.distributed)
    return NodeOptions(
        image=options.application_image,
        readiness=options.readiness,
        update=options.rolling_update,
        volumes=[volume.name for volume in options.persistent_storage.volumes],
        placement=Placement(
            labels={LabelKey(key): LabelValue(value) for key, value in labels.items()}
        ),
        patch=options.additional_k8s_params.application,
    )


def replaces_container(options: OrchestrationOptions) -> bool:
    """Return whether the pod has only the user's containers: no image, and none called ros-app."""
    names = [c.get("name") for c in containers_of(options.additional_k8s_params.application)]
    return bool(names) and APP_CONTAINER not in names and options.application_image is None


def remote_selector(distributed: Distributed) -> dict[str, str]:
    """Return the labels of the application's machine."""
    remote = distributed.enabled and distributed.default_to_remote
    return dict(REMOTE) if remote and not distributed.force_local_flag else {}

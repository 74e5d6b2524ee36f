"""What src.plugin's Rigelfiles have: one application, and jobs that describe a part of a release.

The application is a node: a Deployment of the release's name. update_k8s describes only a part.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.recording import VOLUME, is_recorder
from rigel_k8s.objects.overlay import containers_of, merge, simplify
from rigel_k8s.objects.podoptions import Placement, Toleration
from rigel_k8s.objects.pods import STAY
from rigel_k8s.objects.scalars import LabelKey, LabelValue, VolumeName
from rigel_k8s.rigelfile.fields import fields_by_key

APP_CONTAINER = "ros-app"
#: The label of remote machines, as in src.plugin.
REMOTE = {LabelKey("deploymentType"): LabelValue("remote")}
#: A remote machine is a robot: its pod stays while its network fails.
STAYING = [Toleration(key=LabelKey(k), operator="Exists", effect="NoExecute") for k in STAY]
#: A job with one of these describes a whole release.
WHOLE = ("nodes", "application_image", "deploy_ros_master")
#: Options whose parts belong together: a mix of an old and a new one would be invalid.
AS_ONE = ("readiness", "rolling_update", "results")


def has_application(options: OrchestrationOptions) -> bool:
    """Return whether there is an application in addition to `nodes`."""
    return bool(options.application_image or options.additional_k8s_params.application)


def application_options(options: OrchestrationOptions) -> NodeOptions:
    """Return the application's keys as those of a node, which runs the image's CMD."""
    far = options.distributed
    others = {VOLUME} if any(is_recorder(one.args) for one in options.nodes.values()) else set()
    remote = far.enabled and far.default_to_remote and not far.force_local_flag
    return NodeOptions(
        image=options.application_image,
        readiness=options.readiness,
        update=options.rolling_update,
        volumes=[
            VolumeName(v.name) for v in options.persistent_storage.volumes if v.name not in others
        ],
        placement=Placement(labels=REMOTE if remote else {}),
        tolerations=list(STAYING) if remote else [],
        image_pull_policy="IfNotPresent" if remote else None,
        patch=options.additional_k8s_params.application,
    )


def replaces_container(options: OrchestrationOptions) -> bool:
    """Return whether the pod has only the user's containers: no image, and none called ros-app."""
    names = [c.get("name") for c in containers_of(options.additional_k8s_params.application)]
    return bool(names) and APP_CONTAINER not in names and options.application_image is None


def flat(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return a job's `with` without src.plugin's extra level, as plain data."""
    result: dict[str, Any] = simplify(raw)
    nested = result.pop(OrchestrationOptions.nested_under, None)
    return {**(nested or {}), **result}


def is_partial(raw: Mapping[str, Any]) -> bool:
    """Return whether a job describes only how a release differs from its last revision."""
    keys = flat(raw).keys()
    added = keys - fields_by_key(OrchestrationOptions).keys()  # they stand for nodes
    return not added and keys.isdisjoint(WHOLE)


def overlay(previous: Mapping[str, Any], raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a release's last revision with a partial job's merged in."""
    part = flat(raw)
    kept = {key: v for key, v in flat(previous).items() if key not in AS_ONE or key not in part}
    result: dict[str, Any] = merge(kept, part)
    return result

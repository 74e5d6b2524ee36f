"""Global parameters of ROS 1: a Deployment that sets them at the master before the nodes start.

No node's container can set them: many nodes read one parameter, and one that restarts would write
over later changes. The Deployment's program is rigel_inpod/globalparameters.py.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from rigel_k8s.app.environment import environment, ros_variables
from rigel_k8s.app.generation import Companion, Texts
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH, list_global_keys, list_local, tree
from rigel_k8s.app.programs import begin, list_steps, write_values
from rigel_k8s.network.wiring import PodIdentity, Wiring
from rigel_k8s.objects.marks import FIRST_ANNOTATION
from rigel_k8s.objects.naming import ROS_ANNOTATION, object_name
from rigel_k8s.objects.podoptions import Readiness
from rigel_k8s.objects.pods import Object, drop_empty, inpod_volume, probes
from rigel_k8s.objects.workloads import ReleaseContext, config_map, deployment
from rigel_k8s.problems import Path

CONTAINER = "global-parameters"
#: On nodes: which global parameters they started with, so that a change restarts them.
PARAMETERS_ANNOTATION = "rigel-k8s/global-parameters"
#: Its own resources, since it has no options: a quota may refuse pods without requests.
RESOURCES = {"requests": {"cpu": "10m", "memory": "48Mi"}, "limits": {"memory": "512Mi"}}
#: rigel_inpod/globalparameters.py writes it: "set", or why they are not.
STATE = "/tmp/rigel-k8s-global-parameters"
READY = f'read -r state <{STATE} && echo "$state" && test "$state" = set'


def setter_of(options: OrchestrationOptions, image: str) -> Companion:
    """Return the Deployment, and a ConfigMap of its name; each image of ROS 1 can set values.

    Args:
        image: roscore's.
    """
    own = options.image or options.application_image or image
    identity = PodIdentity(object_name(f"{options.deployment_name}-{CONTAINER}"), str(own))

    def objects(
        release: ReleaseContext, texts: Texts, wired: Wiring, place: Mapping[str, Any]
    ) -> Iterator[tuple[Path, Object]]:
        path = (list_global_keys(options)[0],)
        mounted = {name: texts.files[file] for name, file in list_local(options)}
        if options.parameters:
            mounted |= write_values(tree(options.parameters))
        volume, mount = inpod_volume(release.release)
        volumes, mounts = [volume], [mount]
        if mounted:
            yield path, config_map(release, identity.name, mounted, part_of=identity.name)
            name = "rigel-parameters"
            volumes.append({"name": name, "configMap": {"name": identity.name}})
            mounts.append({"name": name, "mountPath": PARAMETERS_PATH, "readOnly": True})
        # The parameter that marks that those of the release are set.
        mark = f"/rigel_k8s/{re.sub('[^a-z0-9]', '_', release.release)}/global_parameters"
        line = [*begin("ros1", options), *list_steps(options, "/"), "--keep", mark]
        container = {
            "name": CONTAINER,
            "image": identity.image,
            "args": line,
            "env": environment(ros_variables(release), wired.env),
            **probes(Readiness(command=["/bin/sh", "-c", READY]), ()),
            "resources": RESOURCES,
            "volumeMounts": [*mounts, *wired.mounts],
        }
        pod = {
            "initContainers": list(wired.init_containers),
            "containers": [container],
            "volumes": [*volumes, *wired.volumes],
            **place,
            **wired.pod,
        }
        notes = {ROS_ANNOTATION: "none"}
        restart = {PARAMETERS_ANNOTATION: digest([line, mounted])}
        yield (
            path,
            deployment(
                release,
                identity.name,
                drop_empty(pod),
                strategy={"type": "Recreate"},
                annotations={**notes, FIRST_ANNOTATION: "true"},
                pod_annotations={**notes, **restart, **wired.annotations},
            ),
        )

    title = "the Deployment for global parameters"
    return Companion(identity=identity, title=title, objects=objects)


def digest(value: Any) -> str:
    """Return a short hash of plain data."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]

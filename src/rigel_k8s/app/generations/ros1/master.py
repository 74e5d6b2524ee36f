"""roscore: the Deployment and Service `ros-master`.

Two roscores behind one Service are worse than none, so the old one ends before the new one starts.
It has no liveness probe: restarting a busy roscore would destroy the whole graph. For the same
reason the readiness probe is patient: a pod that is not ready is left out of the Service. Pods of
nodes restart with it where it forgets them: `bind`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.application import has_application
from rigel_k8s.app.environment import environment, ros_variables
from rigel_k8s.app.generation import Companion, Texts
from rigel_k8s.app.generations.ros1.gate import behind_gate, gate_objects
from rigel_k8s.app.generations.ros1.globalparameters import PARAMETERS_ANNOTATION
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.network.wiring import PodIdentity, Wiring
from rigel_k8s.objects.marks import FIRST_ANNOTATION, IMAGE_ANNOTATION, SINGLETON_ANNOTATION
from rigel_k8s.objects.naming import ROS_ANNOTATION
from rigel_k8s.objects.overlay import merge
from rigel_k8s.objects.pods import (
    DEFAULT_CONTAINER,
    GATE_CONTAINER,
    GATE_PORT,
    MASTER_CONTAINER,
    MASTER_NAME,
    MASTER_PORT,
    MASTER_URI,
    SCRIPTS_PATH,
    Object,
    drop_empty,
    inpod_volume,
    probes,
    stays,
    stop_hook,
    tolerations,
)
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.workloads import ReleaseContext, deployment, service
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.problems import Path

#: The node that each roscore has.
ROSOUT = "/rosout"
#: What to do if its image cannot be pulled, or has no roscore.
IMAGE_OPTION = "this is roscore's image: set `ros_master_image`"

#: A replaced pod's address swallows what is sent to it. roscore still calls the old node to end it
#: (and to update cached parameters), each time in one of 3 threads, for two minutes: with three
#: such pods no node learns of a new publisher. So 10 threads, and 3 s for a connection.
MASTER_OPTIONS = ["-w", "10", "-t", "3"]
ROSCORE = ["/bin/sh", f"{SCRIPTS_PATH}/roscore.sh", *MASTER_OPTIONS]
#: On the pods of ROS nodes: which roscore they register with.
MASTER_ANNOTATION = "rigel-k8s/master"


def deploys_master(options: OrchestrationOptions) -> bool:
    """Return whether the release has a roscore of its own."""
    if options.deploy_ros_master is None:
        return options.ros_master_uri is None and bool(options.nodes or has_application(options))
    return options.deploy_ros_master


def master_uri(options: OrchestrationOptions) -> str:
    """Return the ROS_MASTER_URI of all nodes; an image may start roscore itself."""
    if options.ros_master_uri:
        return str(options.ros_master_uri)
    return MASTER_URI if deploys_master(options) else f"http://localhost:{MASTER_PORT}"


def image_of(options: OrchestrationOptions, distro: str) -> str:
    """Return roscore's image: the official one, or a copy of it that the nodes run."""
    if options.ros_master_image:
        return str(options.ros_master_image)
    if options.image and is_official(str(options.image), distro):
        return str(options.image)
    return f"ros:{distro}-ros-core"


def is_official(image: str, distro: str) -> bool:
    """Return whether an image is one of the official ones, wherever it is: all have a roscore.

    Any other image that has one may change with each build, and roscore would restart with it.
    """
    name = image.partition("@")[0].rpartition("/")[2]
    return re.fullmatch(rf"ros:{re.escape(distro)}(-[\w.-]+)?", name) is not None


def master_of(options: OrchestrationOptions, distro: str) -> Companion:
    identity = PodIdentity(MASTER_NAME, image_of(options, distro))

    def objects(
        release: ReleaseContext, texts: Texts, wired: Wiring, place: Mapping[str, Any]
    ) -> Iterator[tuple[Path, Object]]:
        if release.gate:
            for item in gate_objects(release, texts.program):
                yield ("gate",), item
        master = master_deployment(release, identity.image, options, wired)
        yield ("deploy_ros_master",), master_service(release, master)
        yield ("deploy_ros_master",), master

    return Companion(identity=identity, title="roscore", objects=objects, ros_name=ROSOUT)


def master_deployment(
    release: ReleaseContext, image: str, options: OrchestrationOptions, wired: Wiring
) -> Object:
    """Return roscore's Deployment with the user's own parts merged in."""
    place = options.ros_master_placement
    volume, mount = inpod_volume(release.release)
    # Its pod becomes unready after a minute of silence.
    ready = probes("ros", ("master",))
    ready["readinessProbe"]["failureThreshold"] = 6
    own = attrs.evolve(release, master_uri=f"http://localhost:{MASTER_PORT}")
    container = {
        "name": MASTER_CONTAINER,
        "image": image,
        "args": list(ROSCORE),
        "env": environment(ros_variables(own), wired.env),
        "ports": [{"name": "ros", "containerPort": MASTER_PORT}],
        **ready,
        "lifecycle": stop_hook(),
        "volumeMounts": [mount, *wired.mounts],
    }
    pod = drop_empty(
        {
            "initContainers": list(wired.init_containers),
            "containers": [container],
            "volumes": [volume, *wired.volumes],
            "nodeSelector": place.node_selector,
            "tolerations": tolerations([], pinned=place.machine is not None),
            **wired.pod,
        }
    )
    notes = dict(wired.annotations)
    if release.gate:
        pod = behind_gate(pod, release.release)
        notes[DEFAULT_CONTAINER] = MASTER_CONTAINER
    made = deployment(
        release,
        MASTER_NAME,
        pod,
        strategy={"type": "Recreate"},
        replicas=1,
        annotations={
            SINGLETON_ANNOTATION: ROSOUT,
            FIRST_ANNOTATION: "true",
            IMAGE_ANNOTATION: IMAGE_OPTION,
        },
        pod_annotations=notes,
    )
    merged: Object = merge(made, options.additional_k8s_params.ros_master)
    return merged


def master_service(release: ReleaseContext, master: Mapping[str, Any]) -> Object:
    """Return the Service by which all pods find roscore.

    When a machine is lost, its pod continues to exist until the machine is back, and another pod
    replaces it elsewhere: a Service that publishes unready pods would send half of all calls to the
    lost one. A pod that stays on its machine has no such replacement. It keeps its address, because
    cutting off the graph from a master that works again would only do harm.

    Args:
        master: roscore's Deployment.
    """
    ports = {"ros": MASTER_PORT} | ({"hand-over": GATE_PORT} if release.gate else {})
    listed = [
        {"name": name, "port": port, "targetPort": port, "protocol": "TCP"}
        for name, port in ports.items()
    ]
    made = service(release, MASTER_NAME, listed)
    if stays(master["spec"]["template"]["spec"]):
        made["spec"]["publishNotReadyAddresses"] = True
    return made


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

"""roscore: the Deployment and Service `ros-master`.

Two roscores behind one Service are worse than none, so the old one ends before the new one starts.
It has no liveness probe: restarting a busy roscore would destroy the whole graph. For the same
reason the readiness probe is patient: a pod that is not ready is left out of the Service.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.app.environment import environment, ros_variables
from rigel_k8s.app.gate import behind_gate
from rigel_k8s.network.wiring import Wiring
from rigel_k8s.objects.marks import FIRST_ANNOTATION, SINGLETON_ANNOTATION
from rigel_k8s.objects.overlay import merge
from rigel_k8s.objects.pods import (
    DEFAULT_CONTAINER,
    GATE_PORT,
    MASTER_NAME,
    MASTER_PORT,
    SCRIPTS_PATH,
    Object,
    drop_empty,
    inpod_volume,
    probes,
    stop_hook,
)
from rigel_k8s.objects.tolerations import stays, tolerations
from rigel_k8s.objects.workloads import ReleaseContext, deployment, service

MASTER_CONTAINER = "ros-master-container"

#: A replaced pod's address swallows what is sent to it. roscore still calls the old node to end it
#: (and to update cached parameters), each time in one of 3 threads, for two minutes: with three
#: such pods no node learns of a new publisher. So 10 threads, and 3 s for a connection.
MASTER_OPTIONS = ["-w", "10", "-t", "3"]
ROSCORE = ["/bin/sh", f"{SCRIPTS_PATH}/roscore.sh", *MASTER_OPTIONS]


def master_deployment(
    around: ReleaseContext,
    image: str,
    params: Mapping[str, Any],
    wired: Wiring,
    node_selector: Mapping[str, str],
) -> Object:
    """Return roscore's Deployment with the user's own parts merged in."""
    volume, mount = inpod_volume(around.release)
    own = attrs.evolve(around, master_uri=f"http://localhost:{MASTER_PORT}")
    container = {
        "name": MASTER_CONTAINER,
        "image": image,
        "args": list(ROSCORE),
        "env": environment(ros_variables(own), wired.env),
        "ports": [{"name": "ros", "containerPort": MASTER_PORT}],
        **patient(probes("ros", ("master",))),
        "lifecycle": stop_hook(),
        "volumeMounts": [mount, *wired.mounts],
    }
    pod = drop_empty(
        {
            "initContainers": list(wired.init_containers),
            "containers": [container],
            "volumes": [volume, *wired.volumes],
            "nodeSelector": node_selector,
            "tolerations": tolerations([], pinned=bool(node_selector)),
            **wired.pod,
        }
    )
    notes = dict(wired.annotations)
    if around.gate:
        pod = behind_gate(pod, around.release)
        notes[DEFAULT_CONTAINER] = MASTER_CONTAINER
    made = deployment(
        around,
        MASTER_NAME,
        pod,
        strategy={"type": "Recreate"},
        annotations={SINGLETON_ANNOTATION: "/rosout", FIRST_ANNOTATION: "true"},
        pod_annotations=notes,
    )
    merged: Object = merge(made, params)
    return merged


def patient(made: Object) -> Object:
    """Return roscore's probes; its pod becomes unready after a minute of silence."""
    return {**made, "readinessProbe": {**made["readinessProbe"], "failureThreshold": 6}}


def master_service(around: ReleaseContext, master: Mapping[str, Any]) -> Object:
    """Return the Service by which all pods find roscore.

    When a machine is lost, its pod continues to exist until the machine is back, and another pod
    replaces it elsewhere: a Service that publishes unready pods would send half of all calls to the
    lost one. A pod that stays on its machine has no such replacement. It keeps its address, because
    cutting off the graph from a master that works again would only do harm.

    Args:
        master: roscore's Deployment.
    """
    ports = {"ros": MASTER_PORT} | ({"hand-over": GATE_PORT} if around.gate else {})
    listed = [
        {"name": name, "port": port, "targetPort": port, "protocol": "TCP"}
        for name, port in ports.items()
    ]
    made = service(around, MASTER_NAME, listed)
    if stays(master["spec"]["template"]["spec"]):
        made["spec"]["publishNotReadyAddresses"] = True
    return made

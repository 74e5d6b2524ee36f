"""The ROS exporter of an application: a Deployment wired as a ROS node is, but not a ROS node.

A release is good without it: a robot must not stop because its messages are not counted. Prometheus
finds it by annotations on its pod, and its ConfigMap contains what the Rigelfile expects.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Any

import attrs
import yaml

from rigel_k8s import __version__
from rigel_k8s.network.modes import join, wire_pod
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.objects.pods import MASTER_URI, Object, drop_empty
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.objects.workloads import ReleaseContext, config_map, deployment, service
from rigel_k8s.observability.container import CONFIG_ANNOTATION, container
from rigel_k8s.observability.names import COMPONENT, EXPORTER, EXPORTER_PORT
from rigel_k8s.observability.options import RosMetrics
from rigel_k8s.yaml_text import Loader

#: What `rigel image ros-exporter` builds.
EXPORTER_IMAGE = f"ghcr.io/rigel-k8s/ros-exporter:{__version__}"

#: The image is in a registry only if a user has pushed it there.
REMEDY = {
    REMEDY_ANNOTATION: "push its image with `rigel image ros-exporter --push REF` and set"
    " `ros_metrics: {image: REF}`, or set `ros_metrics: false`"
}

FILE, DIRECTORY = "config.json", "/etc/ros-exporter"
USER = 65532


@attrs.frozen
class WatchedGraph:
    """What the exporter watches.

    Attributes:
        expected: the full ROS names of nodes that must exist, and the workload of each.
        known: names that nodes may have if their programs choose their own names.
        once: those of them that end.
        domain: the DDS domain of the nodes.
        placement: fields of the pod's spec that keep it where all the nodes are.
        keepers: where the notes of ROS 2 processes are read, NAME:PORT for each workload; without
            them the exporter takes part in DDS.
        contract: what is expected of topics, by their full names: fields of
            rigel_exporter.expecting.Expected.
        asked: a node of the release reads the metrics.
    """

    expected: Mapping[str, str]
    known: Mapping[str, str] = attrs.field(factory=dict)
    once: tuple[str, ...] = ()
    domain: int = 0
    placement: Mapping[str, Any] = attrs.field(factory=dict)
    keepers: tuple[str, ...] = ()
    contract: Mapping[str, Mapping[str, Any]] = attrs.field(factory=dict)
    asked: bool = False


def exporter_identity(options: RosMetrics) -> PodIdentity:
    """Return the exporter's identity in the network."""
    return PodIdentity(EXPORTER, str(options.image or EXPORTER_IMAGE))


def exporter_objects(
    release: ReleaseContext, options: RosMetrics, graph: WatchedGraph, plan: NetworkPlan
) -> Iterator[Object]:
    """Yield the exporter's configuration, its Deployment, and its Service if a node needs one."""
    if graph.asked:
        yield service(release, EXPORTER, [{"name": "metrics", "port": EXPORTER_PORT}])
    wired = wire_pod(plan, exporter_identity(options))
    if release.ros.dds:
        own = {"domain": graph.domain, "middleware": plan.middleware, **join(plan)}
    else:
        own = find_master(release, wired)
    config = {"ros": release.ros.name, **describe(options, graph), **own}
    text = json.dumps(drop_empty(config), indent=2, sort_keys=True)
    name = f"{release.release}-{EXPORTER}"
    yield config_map(release, name, {FILE: text + "\n"}, part_of=EXPORTER)
    yield deployment(
        release,
        EXPORTER,
        {**graph.placement, **pod(release, options, wired, name)},
        strategy={"type": "Recreate"},
        annotations={OPTIONAL_ANNOTATION: "true", **({} if options.image else REMEDY)},
        pod_annotations={
            "prometheus.io/scrape": "true",
            "prometheus.io/port": str(EXPORTER_PORT),
            CONFIG_ANNOTATION: hashlib.sha256(text.encode()).hexdigest()[:20],
            **wired.annotations,
        },
        own_labels=COMPONENT,
    )


def pod(release: ReleaseContext, options: RosMetrics, wired: Wiring, config: str) -> Object:
    """Return the pod's spec.

    Files of init containers are for ROS' own programs: the exporter itself waits for its interface.
    """
    file = files("rigel_k8s.observability") / "files" / "ros-exporter.yaml"
    fields = yaml.load(file.read_text("utf-8"), Loader)
    fields["image"] = EXPORTER_IMAGE
    if not release.ros.dds:
        fields = {"env": [{"name": "ROS_IP", **address(wired)}], **fields}
    made = {
        "containers": [container(EXPORTER, options, fields)],
        "volumes": [{"name": "configuration", "configMap": {"name": config}}],
        "securityContext": pod_context(USER),
        "automountServiceAccountToken": False,
        "terminationGracePeriodSeconds": 20,
    }
    # ROS 1 nodes on their machines' own networks can be reached from anywhere, multicast cannot.
    return made | (dict(wired.pod) if release.ros.dds else {})


def address(wired: Wiring) -> Object:
    """Return the exporter's own address for ROS 1: that on the second network, else the pod's."""
    found = wired.env.get("ROS_IP", {})
    own = {"valueFrom": {"fieldRef": {"apiVersion": "v1", "fieldPath": "status.podIP"}}}
    return dict(found) if "value" in found else own


def describe(options: RosMetrics, graph: WatchedGraph) -> Object:
    """Return what it measures, for src/rigel_exporter/config.py."""
    return {
        "expected": dict(graph.expected),
        "known": dict(graph.known),
        "once": list(graph.once),
        "keepers": list(graph.keepers),
        "topics": [f"/{str(topic).lstrip('/')}" for topic in options.topics],
        "contract": dict(graph.contract),
        "diagnostics": options.diagnostics or None,
        "clock": options.clock or None,
        "tf": options.tf or None,
        "interval": options.interval.seconds if options.interval else None,
    }


def find_master(release: ReleaseContext, wired: Wiring) -> Object:
    """Return the master's address; if releases share it, also a name that differs by release."""
    uri = wired.env.get("ROS_MASTER_URI", {}).get("value") or release.master_uri
    name = None
    if release.master_uri != MASTER_URI:
        name = "/" + re.sub(r"\W", "_", f"ros_exporter_{release.namespace}_{release.release}")
    return {"master_uri": uri, "name": name}

"""The options of an orchestration job: the peer's keys, and a mapping of ROS nodes.

Every field says what it is for in its metadata; the JSON schema and docs/reference.md are made from
it. It knows no Kubernetes object.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import attrs

from rigel_k8s.manifests.fields import needed, option
from rigel_k8s.manifests.network.options import Mode, Network
from rigel_k8s.manifests.observability import Observability
from rigel_k8s.manifests.resources import Resources
from rigel_k8s.manifests.scalars import (
    Count,
    Delay,
    Duration,
    EnvName,
    ImageRef,
    LabelKey,
    LabelValue,
    MountPath,
    ObjectName,
    Port,
    PortName,
    Quantity,
    Replicas,
    RosName,
    RosUri,
    Share,
)

__all__ = [
    "Device",
    "Distributed",
    "EnvVar",
    "KubernetesParams",
    "Launch",
    "NodeOptions",
    "Observability",
    "OrchestrationOptions",
    "PersistentStorage",
    "Placement",
    "PortOptions",
    "Readiness",
    "Resources",
    "Results",
    "RollingUpdate",
    "Toleration",
    "Volume",
    "VolumeMount",
]

Scalar = str | int | float | bool


@attrs.frozen(kw_only=True)
class Readiness:
    """When a pod counts as ready."""

    command: str | list[str] | None = option("a command that exits 0 when ready: words or a list")
    file: MountPath | None = option("a file that is there when ready, /tmp/ready say")
    initial_delay_seconds: Delay | None = option("seconds before the first probe")
    period_seconds: Count | None = option("seconds between probes once ready (default 10)")
    probe_timeout_seconds: Count | None = option("seconds that one probe may take (default 5)")
    failure_threshold: Count | None = option(
        "failures in a row that make a pod unready (default 2)"
    )
    timeout_seconds: Delay | None = option("seconds that the roll-out waits for it to become ready")


@attrs.frozen(kw_only=True)
class RollingUpdate:
    """How pods of a new revision replace the old ones."""

    strategy: (
        Literal["Rolling", "RollingUpdate", "Recreate", "rolling", "rollingupdate", "recreate"]
        | None
    ) = option(
        "Recreate: the old pod is gone before the new one starts, the default of nodes with a fixed"
        " ROS name; Rolling: the new pod is ready before the old one stops"
    )
    max_surge: Share | None = option("pods more than wanted during an update (default 1)")
    max_unavailable: Share | None = option("pods fewer than wanted during an update (default 0)")


@attrs.frozen(kw_only=True)
class Volume:
    """A persistent volume: the claim NAME-pvc, and with host_path the static volume NAME-pv."""

    name: ObjectName = needed("the volume's name")
    size: Quantity = option("how much storage is asked for", Quantity("1Gi"))
    storage_class: str | None = option("a StorageClass; left out: the cluster's default")
    host_path: MountPath | None = option("a directory of a machine: a static volume on it is made")
    mount_path: MountPath | None = option(
        "where the application sees it (default /persistent/NAME)"
    )
    access_mode: Literal["ReadWriteOnce", "ReadWriteMany", "ReadOnlyMany", "ReadWriteOncePod"] = (
        option("who may mount it at once", "ReadWriteOnce")
    )


@attrs.frozen(kw_only=True)
class PersistentStorage:
    """Volumes whose data outlives pods, updates and `rigel down`."""

    volumes: list[Volume] = option("the volumes", [])


@attrs.frozen(kw_only=True)
class Distributed:
    """The application on remote machines, those labelled deploymentType=remote."""

    enabled: bool = option("whether the other two keys count", default=False)
    default_to_remote: bool = option("place the application on remote machines", default=False)
    force_local_flag: bool = option("do not, whatever default_to_remote says", default=False)


@attrs.frozen(kw_only=True)
class Results:
    """Files that are copied out of the application's newest ready pod after the roll-out."""

    source_path: MountPath = needed("a file or directory inside the container")
    container: ObjectName = option("which container", ObjectName("ros-app"))
    target: str = option("the directory to copy into, from the application's own", "results")
    wait: Duration | None = option("how long to wait for source_path; left out: one look")


@attrs.frozen(kw_only=True)
class KubernetesParams:
    """Anything of a Deployment, laid over what is generated."""

    ros_master: Mapping[str, Any] = option("over the Deployment ros-master", {})
    application: Mapping[str, Any] = option("over the application's Deployment", {})


@attrs.frozen(kw_only=True)
class EnvVar:
    """An environment variable as Kubernetes writes it."""

    name: EnvName = needed("the variable's name")
    value: Scalar | None = option("its value")
    value_from: Mapping[str, Any] | None = attrs.field(
        default=None,
        metadata={
            "key": "valueFrom",
            "aliases": ("value_from",),
            "doc": "where its value comes from: secretKeyRef, configMapKeyRef, fieldRef ...",
        },
    )


@attrs.frozen(kw_only=True)
class PortOptions:
    """A port that others reach through a Service of the node's name."""

    name: PortName | None = option("the port's name")
    port: Port = needed("the port of the container")
    service_port: Port | None = option("the Service's port where it differs")
    protocol: Literal["TCP", "UDP"] = option("the protocol", "TCP")


@attrs.frozen(kw_only=True)
class VolumeMount:
    """What a node sees of a volume; one of name, host_path, config_map, secret and memory."""

    name: ObjectName | None = option("one of persistent_storage.volumes")
    host_path: MountPath | None = option("a directory or file of the machine that the pod runs on")
    config_map: ObjectName | None = option("a ConfigMap of the namespace")
    secret: ObjectName | None = option("a Secret of the namespace")
    memory: Quantity | None = option("memory of this size, for /dev/shm say")
    mount_path: MountPath | None = option("where the container sees it; only `name` has a default")
    sub_path: str | None = option("a path inside the volume")
    read_only: bool = option("refuse writes", default=False)


@attrs.frozen(kw_only=True)
class Device:
    """A device of the machine: a path, or a resource of a device plugin (squat.ai/serial)."""

    path: MountPath | None = option("a device file; opening it wants a privileged security_context")
    mount_path: MountPath | None = option("where the container sees it (default: the same path)")
    resource: LabelKey | None = option("the resource name that a device plugin gives it")
    count: Count = option("how many of the resource", Count(1))


@attrs.frozen(kw_only=True)
class Placement:
    """Where a pod runs."""

    node: ObjectName | None = option("the Kubernetes node's name (kubernetes.io/hostname)")
    labels: Mapping[LabelKey, LabelValue] = option("labels that the Kubernetes node must have", {})
    apart_from: list[str] = option("keys of `nodes` whose pods must be on other machines", [])


@attrs.frozen(kw_only=True)
class Toleration:
    """A taint that the pod tolerates, as Kubernetes has it."""

    key: LabelKey | None = option("the taint's key; left out: all")
    operator: Literal["Exists", "Equal"] | None = option(
        "Equal where `value` is given, else Exists"
    )
    value: LabelValue | None = option("the taint's value for Equal")
    effect: Literal["NoSchedule", "PreferNoSchedule", "NoExecute"] | None = option(
        "left out: all effects"
    )
    seconds: Delay | None = attrs.field(
        default=None,
        metadata={
            "aliases": ("tolerationSeconds",),
            "doc": "how long, for NoExecute; left out: without limit",
        },
    )


@attrs.frozen(kw_only=True)
class Launch:
    """A launch file: roslaunch, or ros2 launch, PACKAGE FILE ARGS."""

    package: str | None = option("the ROS package; left out: file is a path")
    file: str = needed("the launch file")
    args: Mapping[str, Scalar] = option("the launch file's arguments", {})


@attrs.frozen(kw_only=True)
class NodeOptions:
    """One ROS node: a Deployment of one container, called ros-node."""

    name: RosName | None = option("its ROS name where it differs from the key")
    namespace: RosName | None = option("the ROS namespace it lives in")
    ros: Literal["none"] | None = option(
        "none: a program without ROS beside ROS nodes; it gets no name, argument or variable of"
        " ROS, no probe unless one is asked for, and is not looked for in the graph"
    )
    image: ImageRef | None = option("the image (default: the job's `image`)")
    image_pull_policy: Literal["Always", "IfNotPresent", "Never"] | None = option("when to pull it")
    labels: Mapping[LabelKey, LabelValue] = option("labels of the Deployment and its pods", {})
    args: str | list[Scalar] | None = option("what to run, behind the image's ENTRYPOINT")
    command: str | list[Scalar] | None = option("what to run instead of the image's ENTRYPOINT")
    package: str | None = option("a ROS package: rosrun (or ros2 run) PACKAGE EXECUTABLE ARGS")
    executable: str | None = option("an executable of `package`")
    launch: Launch | None = option("a launch file: roslaunch (or ros2 launch) PACKAGE FILE")
    anonymous: bool = option(
        "its ROS name is made at start: replicas and surge are safe", default=False
    )
    env: Mapping[EnvName, Scalar] | list[EnvVar] = option("environment variables", {})
    parameters: Mapping[str, Any] = option("private parameters", {})
    parameter_files: list[str] = option(
        "YAML files of private parameters, from the application's directory", []
    )
    remappings: Mapping[RosName, RosName] = option("ROS names: from -> to", {})
    replicas: Replicas | None = option("how many pods; more than one only where anonymous")
    resources: Resources = attrs.field(factory=Resources, metadata={"doc": "requests and limits"})
    ports: list[Port | PortOptions] = option("ports for a Service of the node's name", [])
    volumes: list[ObjectName | VolumeMount] = option(
        "volumes; a name is one of persistent_storage", []
    )
    devices: list[MountPath | Device] = option("devices of the machine", [])
    security_context: Mapping[str, Any] = option("Kubernetes' securityContext of the container", {})
    runtime_class: ObjectName | None = option("runtimeClassName: nvidia, say")
    readiness: Readiness | Literal["ros", "dds", "none"] | None = option(
        "when it is ready: a command, a file, none, or ros and dds (ROS 1: registered with the"
        " master, and answers; ROS 2 and DDS: takes part in its domain, and reads what it is sent)"
    )
    placement: Placement = attrs.field(factory=Placement, metadata={"doc": "where it runs"})
    tolerations: list[Toleration] = option("taints it tolerates", [])
    host_network: bool = option("use the machine's own network", default=False)
    service_account: ObjectName | None = option("serviceAccountName")
    termination_grace_period: Duration | None = option("how long it may take to stop (default 30s)")
    update: RollingUpdate | None = option("how it is updated")
    patch: Mapping[str, Any] = option("anything of the Deployment, laid over what is generated", {})


@attrs.frozen(kw_only=True)
class OrchestrationOptions:
    """What the job deploys."""

    #: The peer's users write all keys below this one; both shapes mean the same.
    nested_under: ClassVar[str] = "orchestration"

    namespace: ObjectName | None = option("the Kubernetes namespace; made where it is missing")
    deployment_name: ObjectName = option(
        "the release's name, and that of the application's Deployment;"
        " two jobs that name one release change one application",
        ObjectName("rigel-k8s-application"),
    )
    deploy_ros_master: bool | None = option(
        "ROS 1: deploy roscore as ros-master (default: unless there is a ros_master_uri)"
    )
    ros_master_image: ImageRef | None = option("roscore's image (default ros:DISTRO-ros-core)")
    ros_master_uri: RosUri | None = option("a master that is there already, a robot's own")
    application_image: ImageRef | None = option("the image of the one application's Deployment")
    image: ImageRef | None = option("the image of all `nodes` that name none")
    nodes: Mapping[str, NodeOptions] = option("the ROS nodes, each a Deployment, by ROS name", {})
    ros: Literal["1", "2", "none"] | None = option(
        "which ROS; none is a plain DDS application (default: that of application.distro)"
    )
    middleware: (
        Literal["fastdds", "cyclonedds", "zenoh"]
        | Literal["rmw_fastrtps_cpp", "rmw_cyclonedds_cpp", "rmw_zenoh_cpp"]
        | None
    ) = attrs.field(
        default=None,
        metadata={
            "aliases": ("rmw",),
            "doc": "ROS 2: RMW_IMPLEMENTATION; DDS: whose configuration the network writes",
        },
    )
    network: Network | Mode | None = option(
        "how pods find each other; a word is short for its `mode`"
    )
    readiness: Readiness | Literal["ros", "dds", "none"] | None = option(
        "when the application is ready (default: ros; a plain DDS application: none)"
    )
    allow_sidecars: bool = option(
        "allow more than one container in a pod of ROS 2 or DDS", default=False
    )
    rolling_update: RollingUpdate | None = option("how the application is updated")
    persistent_storage: PersistentStorage = attrs.field(
        factory=PersistentStorage, metadata={"doc": "volumes; the application mounts all of them"}
    )
    distributed: Distributed = attrs.field(factory=Distributed, metadata={"doc": "remote machines"})
    observability: Observability = attrs.field(
        factory=Observability, metadata={"doc": "logs, metrics and dashboards"}
    )
    observability_only: bool = option("deploy nothing but observability", default=False)
    results: Results | None = option("files to copy out of the application afterwards")
    additional_k8s_params: KubernetesParams = attrs.field(
        factory=KubernetesParams, metadata={"doc": "laid over the generated Deployments"}
    )
    image_pull_secrets: list[ObjectName] = option("Secrets with registry credentials", [])
    timeout: Duration | None = option("how long the roll-out may take (default 5m)")

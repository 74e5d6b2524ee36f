"""The options of an orchestration job: src.plugin's keys, and a mapping of ROS nodes.

Every field has its documentation in its metadata; the JSON schema and docs/reference.md use
it. Independent of Kubernetes objects.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import attrs

from rigel_k8s.app import foxglove, recording
from rigel_k8s.app.expectations import Expectation
from rigel_k8s.app.foreign import OF_JOBS, OF_NODES
from rigel_k8s.app.networkpolicy import NetworkPolicy
from rigel_k8s.app.security import Level, Security, security_of
from rigel_k8s.network.options import ModeName, Network, middleware_name, network_of
from rigel_k8s.objects.fields import option, required_field, true_is_default
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.objects.podoptions import (
    Device,
    EnvVar,
    Machines,
    PersistentStorage,
    Placement,
    PortOptions,
    Readiness,
    RollingUpdate,
    Scalar,
    ServiceType,
    Toleration,
    VolumeMount,
)
from rigel_k8s.objects.resources import Resources
from rigel_k8s.objects.scalars import (
    DevicePath,
    DottedName,
    Duration,
    EnvName,
    ImageRef,
    LabelKey,
    LabelValue,
    MountPath,
    ObjectName,
    Port,
    RemapName,
    Replicas,
    RosName,
    RosUri,
    VolumeName,
)
from rigel_k8s.observability.options import Observability
from rigel_k8s.rigelfile.expansion import Extension


@attrs.frozen(kw_only=True)
class Distributed:
    """The application on remote machines, those labelled deploymentType=remote."""

    enabled: bool = option("whether the other two keys count", default=False)
    default_to_remote: bool = option("place the application on remote machines", default=False)
    force_local_flag: bool = option("overrides default_to_remote", default=False)


@attrs.frozen(kw_only=True)
class Results:
    """Files that are copied out of the application's newest ready pod after the roll-out."""

    source_path: MountPath = required_field("a file or directory inside the container")
    container: ObjectName = option("which container", ObjectName("ros-app"))
    target: str = option("the directory to copy into, from the application's own", "results")
    wait: Duration | None = option("how long to wait for source_path (default: not at all)")


@attrs.frozen(kw_only=True)
class RollbackOn:
    """What makes an update return to the last good revision automatically."""

    example: ClassVar[str] = "{graph_worse: true}"

    graph_worse: bool = option(
        "the ROS graph stays worse than before the update: a node, a topic's publishers or"
        " subscribers, or a service is missing, types no longer fit, or a rate is less than half",
        default=False,
    )
    within: Duration | None = option(
        "how long after the roll-out the graph may stay worse (default 60s)"
    )


@attrs.frozen(kw_only=True)
class UpdateTime:
    """When an update may replace pods."""

    example: ClassVar[str] = "{when: idle}"

    when: Literal["idle"] = required_field(
        "idle: while no action server of the release has a goal in progress"
    )
    silent: Mapping[RosName, Duration] = option(
        "and while no node of the release has published a topic for so long, as in {/cmd_vel: 3s}",
        {},
    )
    within: Duration | None = option("how long to wait for that (default 10m); then it fails")


@attrs.frozen(kw_only=True)
class KubernetesParams:
    """Any part of a Deployment, merged into the generated one."""

    ros_master: Mapping[str, Any] = option("for the Deployment ros-master", {})
    application: Mapping[str, Any] = option("for the application's Deployment", {})


@attrs.frozen(kw_only=True)
class Launch:
    """A launch file: roslaunch, or ros2 launch, PACKAGE FILE ARGS."""

    example: ClassVar[str] = "{package: PACKAGE, file: FILE}"

    package: str | None = option("the ROS package (default: `file` is a path)")
    file: str = required_field("the launch file")
    args: Mapping[str, Scalar] = option("the launch file's arguments", {})


@attrs.frozen(kw_only=True)
class ParameterFile:
    """A YAML file of parameters: one beside the Rigelfile, or one in the image."""

    file: str | None = option("a file, relative to the application's directory")
    image_file: str | None = option(
        "a file in the image; with `substitution_args` also $(find PACKAGE)/config/rates.yaml"
    )
    namespace: RemapName | None = option("ROS 1: where its parameters go, below the node's name")


@attrs.frozen(kw_only=True)
class Component:
    """A composable node of ROS 2, or a nodelet of ROS 1."""

    package: str | None = option("ROS 2: the package that has the plugin")
    plugin: str = required_field(
        "the class: image_proc::RectifyNode in ROS 2, image_proc/rectify in ROS 1"
    )
    name: RosName | None = option("its ROS name, if it differs from the key")
    namespace: RosName | None = option("its ROS namespace")
    parameters: Mapping[str, Any] = option("its private parameters", {})
    remappings: Mapping[RemapName, RemapName] = option("ROS names: from -> to", {})
    extra_arguments: Mapping[str, Scalar] = option(
        "ROS 2: further arguments of the component, such as use_intra_process_comms", {}
    )

    def full_name(self, key: str) -> str:
        """Return the component's full ROS name, by its key."""
        return ros_name(self.name or key, self.namespace)


Transition = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]


@attrs.frozen(kw_only=True)
class Lifecycle:
    """The transitions of a lifecycle node (a managed node)."""

    start: list[Transition] = option(
        "at its start, one after the other; the pod is ready when the last one is made", []
    )
    stop: list[Transition] = option("before its pod ends", [])


@attrs.frozen(kw_only=True)
class Liveness:
    """When the container of a ROS 2 node is restarted."""

    example: ClassVar[str] = "{stuck: 30s}"

    stuck: Duration | None = option(
        "when for so long, as in 30s, an executor has not looked for work because of a callback, "
        "or DDS has not read what it was sent"
    )
    silent: Mapping[RosName, Duration] = option(
        "when a topic that it has published, by its full name, is silent for so long, as in"
        " {/scan: 2s}",
        {},
    )


@attrs.frozen(kw_only=True)
class NodeOptions:
    """One ROS node: a Deployment of one container, called ros-node; or a container of a `pod`.

    A `kind` makes it a Job.
    """

    foreign: ClassVar[Mapping[str, str]] = OF_NODES

    name: RosName | None = option("its ROS name, if it differs from the key")
    namespace: RosName | None = option("its ROS namespace")
    kind: Literal["task", "test"] | None = option(
        "what runs once, and succeeds with exit code 0. task: a deploy runs it, and waits for its"
        " end; test: only `rigel test` runs it"
    )
    ros: Literal["none"] | None = option(
        "none: a program without ROS beside ROS nodes; it gets no name, argument or variable of"
        " ROS, no probe by default, and is not expected in the graph"
    )
    image: ImageRef | None = option("the image (default: the job's `image`)")
    image_pull_policy: Literal["Always", "IfNotPresent", "Never"] | None = option("when to pull it")
    labels: Mapping[LabelKey, LabelValue] = option("labels of the Deployment and its pods", {})
    args: str | list[Scalar] | None = option("what to run, as arguments of the image's ENTRYPOINT")
    command: str | list[Scalar] | None = option("what to run instead of the image's ENTRYPOINT")
    package: str | None = option("a ROS package: rosrun (or ros2 run) PACKAGE EXECUTABLE ARGS")
    executable: str | None = option("an executable of `package`")
    launch: Launch | None = option("a launch file: roslaunch (or ros2 launch) PACKAGE FILE")
    components: Mapping[str, Component] = option(
        "composable nodes (ROS 1: nodelets) by ROS name, which this node loads at its start; it is"
        " rclcpp_components' component_container (nodelet's manager) if it has no program",
        {},
    )
    lifecycle: Lifecycle | None = option(
        "ROS 2: the transitions of a lifecycle node, as in {start: [configure, activate]}"
    )
    anonymous: bool = option(
        "its ROS name is generated at its start: it may have replicas, and its update is Rolling by"
        " default",
        default=False,
    )
    env: Mapping[EnvName, Scalar] | list[EnvVar] = option("environment variables", {})
    parameters: Mapping[str, Any] = option("private parameters", {})
    parameter_files: list[str | ParameterFile] = option(
        "YAML files of private parameters; a path is short for a `file`", []
    )
    parameter_commands: Mapping[str, str | list[Scalar]] = option(
        "private parameters whose values are printed by programs of the image: xacro FILE", {}
    )
    substitution_args: bool = option(
        "replace $(find PACKAGE), $(env NAME) and $(optenv NAME DEFAULT) inside the container,"
        " in its command line, in `env`, and in its parameters and those of its components",
        default=False,
    )
    remappings: Mapping[RemapName, RemapName] = option("ROS names: from -> to", {})
    pod: ObjectName | None = option(
        "ROS 2: the name of a pod that it shares with all nodes that set the same one: each has a"
        " container of its own, called as its Deployment would be, and they share memory for large"
        " messages"
    )
    replicas: Replicas | None = option("how many pods; more than one only if anonymous")
    resources: Resources = attrs.field(factory=Resources, metadata={"doc": "requests and limits"})
    ports: list[Port | PortOptions] = option("ports for a Service of the node's name", [])
    service_type: ServiceType | None = option(
        "type of that Service (default ClusterIP: not reachable from outside of the cluster)"
    )
    volumes: list[VolumeName | VolumeMount] = option(
        "volumes; a name is one of persistent_storage", []
    )
    files: Mapping[MountPath, str] = option(
        "files and folders beside the Rigelfile, mounted read-only: path in the container -> path,"
        " relative to the application's directory",
        {},
    )
    devices: list[DevicePath | Device] = option("devices of the machine", [])
    security_context: Mapping[str, Any] = option("Kubernetes' securityContext of the container", {})
    runtime_class: DottedName | None = option("runtimeClassName, for example nvidia")
    readiness: Readiness | Literal["ros", "dds", "none"] | None = option(
        "when it is ready: a command, a file, none, or ros and dds (ROS 1: registered with the"
        " master, and answers; ROS 2 and DDS: takes part in its domain, and reads its messages)"
    )
    liveness: Liveness | None = option("ROS 2: when its container is restarted (default: never)")
    placement: Placement = attrs.field(factory=Placement, metadata={"doc": "where it runs"})
    tolerations: list[Toleration] = option("taints it tolerates", [])
    host_network: bool = option("use the machine's own network", default=False)
    service_account: DottedName | None = option("serviceAccountName")
    termination_grace_period: Duration | None = option("how long it may take to stop (default 30s)")
    update: RollingUpdate | None = option("how it is updated")
    rmw_layer: bool | None = option(
        "ROS 2: load our library into its processes; without it, updates of the node are Recreate"
        " (default: the job's)"
    )
    patch: Mapping[str, Any] = option(
        "any part of the Deployment or Job, merged into the generated one", {}
    )


@attrs.frozen(kw_only=True)
class OrchestrationOptions:
    """What the job deploys."""

    #: src.plugin's users write all keys below this one; both shapes mean the same.
    nested_under: ClassVar[str] = "orchestration"
    foreign: ClassVar[Mapping[str, str]] = OF_JOBS
    #: Keys that stand for nodes: our own, and those that other packages add, such as `muto`.
    expanded: ClassVar[Mapping[str, Extension]] = {
        foxglove.KEY: foxglove.EXTENSION,
        recording.KEY: recording.EXTENSION,
    }
    extended_by: ClassVar[str] = "rigel_k8s.options"

    namespace: ObjectName | None = option("the Kubernetes namespace; created if it does not exist")
    deployment_name: ObjectName = option(
        "the release's name, and that of the application's Deployment;"
        " two jobs with the same name change the same application",
        ObjectName("rigel-k8s-application"),
    )
    deploy_ros_master: bool | None = option(
        "ROS 1: deploy roscore as ros-master (default: unless there is a ros_master_uri)"
    )
    ros_master_image: ImageRef | None = option(
        "roscore's image (default: `image` if that is ros:DISTRO of any registry, else"
        " ros:DISTRO-ros-core)"
    )
    ros_master_placement: Machines = attrs.field(
        factory=Machines,
        metadata={"doc": "the machine of roscore, which stays there while it is unreachable"},
    )
    gate: bool | None = option(
        "ROS 1: put a gate in front of roscore, which hands over the names of nodes in updates and"
        " gives a restarted roscore its registrations back (default: with noetic's roscore, unless"
        " additional_k8s_params set what its container runs)"
    )
    ros_master_uri: RosUri | None = option("an existing master, for example a robot's own")
    application_image: ImageRef | None = option("the image of the one application's Deployment")
    image: ImageRef | None = option("the image of all `nodes` without one")
    nodes: Mapping[str, NodeOptions] = option("the ROS nodes, each a Deployment, by ROS name", {})
    parameters: Mapping[str, Any] = option(
        "ROS 1: global parameters, set before the nodes start", {}
    )
    parameter_files: list[str | ParameterFile] = option(
        "ROS 1: YAML files of global parameters; a path is short for a `file`", []
    )
    parameter_commands: Mapping[str, str | list[Scalar]] = option(
        "ROS 1: global parameters whose values are printed by programs of the image", {}
    )
    substitution_args: bool = option(
        "replace $(find PACKAGE), $(env NAME) and $(optenv NAME DEFAULT) in global parameters; a"
        " node has an option of its own",
        default=False,
    )
    ros_version: Literal["ros1", "ros2"] | None = option(
        "src.plugin's word for the ROS of application.distro; only compared with that"
    )
    ros: Literal["1", "2", "none"] | None = option(
        "which ROS; none is a plain DDS application (default: that of application.distro)"
    )
    middleware: Literal["fastdds", "cyclonedds", "zenoh"] | None = option(
        "ROS 2: RMW_IMPLEMENTATION; DDS: the implementation that the network configures",
        accepts=Literal["fastdds", "cyclonedds", "zenoh"]
        | Literal["rmw_fastrtps_cpp", "rmw_cyclonedds_cpp", "rmw_zenoh_cpp"]
        | None,
        aliases=("rmw",),
        converter=middleware_name,
    )
    rmw_layer: bool = option(
        "ROS 2: load a library into the nodes' processes, between ROS and its middleware, by which"
        " they hand over in updates, are probed, and are measured",
        default=True,
    )
    network: Network | None = option(
        "how pods find each other; a word is short for its `mode`",
        accepts=Network | ModeName | None,
        converter=network_of,
    )
    security: Security | None = option(
        "what containers may do; `restricted` is short for its `level`",
        accepts=Security | Level | None,
        converter=security_of,
    )
    network_policy: NetworkPolicy | None = option(
        "let only pods of this release connect to its pods, where the cluster's network enforces"
        " NetworkPolicies; true is the mapping with its defaults",
        default=False,
        accepts=bool | NetworkPolicy,
        converter=true_is_default(NetworkPolicy),
    )
    readiness: Readiness | Literal["ros", "dds", "none"] | None = option(
        "when the application is ready (default: ros; a plain DDS application: none)"
    )
    allow_sidecars: bool = option(
        "allow more than one container in a pod of ROS 2 or DDS", default=False
    )
    rolling_update: RollingUpdate | None = option("how the application is updated")
    rollback_on: RollbackOn | None = option("when an update is rolled back automatically")
    update: UpdateTime | None = option("ROS 2: when an update may begin (default: at once)")
    expect: Mapping[RosName, Expectation] = option(
        "what is expected of topics while all runs; `rigel expect` compares, and so does an update",
        {},
    )
    persistent_storage: PersistentStorage = attrs.field(
        factory=PersistentStorage, metadata={"doc": "volumes; the application mounts all of them"}
    )
    distributed: Distributed = attrs.field(factory=Distributed, metadata={"doc": "remote machines"})
    observability: Observability = attrs.field(
        factory=Observability, metadata={"doc": "logs, metrics and dashboards"}
    )
    observability_only: bool = option("deploy only observability", default=False)
    results: Results | None = option("files to copy out of the application afterwards")
    additional_k8s_params: KubernetesParams = attrs.field(
        factory=KubernetesParams, metadata={"doc": "merged into the generated Deployments"}
    )
    image_pull_secrets: list[DottedName] = option("Secrets with registry credentials", [])
    timeout: Duration | None = option("how long the roll-out may take (default 5m)")

"""The parts of a job's options that describe a pod: readiness, volumes, ports, devices, placement.

They are independent of Kubernetes objects; each field documents itself.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import attrs

from rigel_k8s.objects.fields import option, required_field
from rigel_k8s.objects.naming import HOSTNAME
from rigel_k8s.objects.scalars import (
    Count,
    Delay,
    DevicePath,
    DottedName,
    Duration,
    EnvName,
    LabelKey,
    LabelValue,
    MountPath,
    ObjectName,
    Port,
    PortName,
    Quantity,
    Range,
    RosName,
    Share,
)

Scalar = str | int | float | bool
ServiceType = Literal["ClusterIP", "NodePort", "LoadBalancer"]
HostPathType = Literal[
    "Directory", "DirectoryOrCreate", "File", "FileOrCreate", "Socket", "CharDevice", "BlockDevice"
]
#: Those that are reached from outside of the cluster.
OUTSIDE = ("NodePort", "LoadBalancer")


@attrs.frozen(kw_only=True)
class Readiness:
    """When a pod counts as ready."""

    foreign: ClassVar[Mapping[str, str]] = {
        "exec": "write `command`",
        "httpGet": "write `command: [curl, -f, URL]`, or `port`",
        "tcpSocket": "write `port`",
    }

    command: str | list[str] | None = option("a command that exits 0 when ready: words or a list")
    file: MountPath | None = option("a file that exists when ready, such as /tmp/ready")
    port: Port | None = option("a TCP port at which it accepts connections when ready")
    rates: Mapping[RosName, Range] = option(
        "ROS 2: topics that the node publishes, by their full names, and how often it must, in"
        " messages per second: {/scan: 8..12}, 8.. (or more); 10 is short for 8..12. A new version"
        " that is slower does not take over",
        {},
    )
    initial_delay_seconds: Delay | None = option("seconds before the first probe")
    period_seconds: Count | None = option("seconds between probes once ready (default 10)")
    probe_timeout_seconds: Count | None = option("seconds that one probe may take (default 30)")
    failure_threshold: Count | None = option(
        "failures in a row that make a pod unready (default 2)"
    )
    timeout_seconds: Delay | None = option("seconds that the roll-out waits for it to become ready")

    @property
    def own_checks(self) -> list[str]:
        """The keys that replace the check of ROS or DDS."""
        return [key for key in ("command", "file", "port") if getattr(self, key)]


@attrs.frozen(kw_only=True)
class RollingUpdate:
    """How pods of a new revision replace the old ones."""

    example: ClassVar[str] = "{strategy: STRATEGY}"
    foreign: ClassVar[Mapping[str, str]] = {"type": "write `strategy`"}

    strategy: (
        Literal["HandOver", "Rolling", "RollingUpdate", "Recreate"]
        | Literal["handover", "rolling", "rollingupdate", "recreate"]
        | None
    ) = option(
        "HandOver: the new pod starts completely, and takes over in one moment (ROS 1: it gets the"
        " ROS names when the old one stops; ROS 2: it is silent and hears nothing until then);"
        " Recreate: the old pod has ended before the new one starts; Rolling: both work until"
        " the old one stops. Default where two of the pod can run: Rolling for anonymous nodes,"
        " HandOver for others, in ROS 1 behind a gate; else Recreate"
    )
    max_surge: Share | None = option("extra pods during an update (default 1)")
    max_unavailable: Share | None = option("missing pods during an update (default 0)")
    drain: Duration | None = option(
        "ROS 2, HandOver: how long goals of actions may take to end before the new node takes over"
        " (default 5m); the pod may take this much longer to stop"
    )
    warm: list[RosName] = option(
        "ROS 2, HandOver: topics that the new node already hears while it waits, besides latched"
        " ones, /tf and /clock, so that what it computes of them is there when it takes over",
        [],
    )


@attrs.frozen(kw_only=True)
class Volume:
    """A persistent volume: the claim NAME-pvc, and with host_path the static volume NAME-pv."""

    name: ObjectName = required_field("the volume's name")
    size: Quantity = option("how much storage to request", Quantity("1Gi"))
    storage_class: str | None = option("a StorageClass (default: the cluster's default)")
    host_path: MountPath | None = option("a directory of a machine; creates a static volume on it")
    mount_path: MountPath | None = option(
        "where the application sees it (default /persistent/NAME)"
    )
    access_mode: Literal["ReadWriteOnce", "ReadWriteMany", "ReadOnlyMany", "ReadWriteOncePod"] = (
        option("how many machines or pods may mount it at once", "ReadWriteOnce")
    )


@attrs.frozen(kw_only=True)
class PersistentStorage:
    """Volumes whose data outlives pods, updates and `rigel down`."""

    volumes: list[Volume] = option("the volumes", [])


@attrs.frozen(kw_only=True)
class EnvVar:
    """An environment variable as Kubernetes writes it."""

    example: ClassVar[str] = "{name: NAME, value: VALUE}"

    name: EnvName = required_field("the variable's name")
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

    foreign: ClassVar[Mapping[str, str]] = {
        "containerPort": "write `port`",
        "targetPort": "write `port`, and `service_port` for that of the Service",
        "hostPort": "write `host_network` at the node",
        "nodePort": "Kubernetes chooses it: remove it, or write a Service of your own",
    }

    name: PortName | None = option("the port's name")
    port: Port = required_field("the port of the container")
    service_port: Port | None = option("the Service's port if it differs")
    protocol: Literal["TCP", "UDP"] = option("the protocol", "TCP")


@attrs.frozen(kw_only=True)
class VolumeMount:
    """What a node sees of a volume; one of name, host_path, config_map, secret and memory."""

    name: ObjectName | None = option("one of persistent_storage.volumes")
    host_path: MountPath | None = option("a directory or file of the machine that the pod runs on")
    type: HostPathType | None = option(
        "what `host_path` must be on the machine, where ...OrCreate creates what is missing"
        " (default: what its name shows, as Directory for /data/maps)"
    )
    config_map: DottedName | None = option("a ConfigMap of the namespace")
    secret: DottedName | None = option("a Secret of the namespace")
    memory: Quantity | None = option("memory of this size, for example for /dev/shm")
    mount_path: MountPath | None = option(
        "where the container sees it; required unless `name` is set"
    )
    sub_path: str | None = option("a path inside the volume")
    read_only: bool = option("refuse writes", default=False)


@attrs.frozen(kw_only=True)
class Device:
    """A device of the machine: a path, or a resource of a device plugin (squat.ai/serial)."""

    path: DevicePath | None = option(
        "a device file; opening it needs a privileged security_context"
    )
    mount_path: MountPath | None = option(
        "where the container sees it (default: the same path, with _ for each colon)"
    )
    resource: LabelKey | None = option("the resource name of a device plugin")
    count: Count = option("how many of the resource", Count(1))


@attrs.frozen(kw_only=True)
class Machines:
    """The Kubernetes nodes that a pod may run on."""

    example: ClassVar[str] = "{node: robot-1}"
    foreign: ClassVar[Mapping[str, str]] = {
        "nodeName": "write `node`",
        "nodeSelector": "write `labels`",
    }

    node: DottedName | None = option("the Kubernetes node's name (kubernetes.io/hostname)")
    labels: Mapping[LabelKey, LabelValue] = option("labels that the Kubernetes node must have", {})

    @property
    def node_selector(self) -> dict[str, str]:
        """The labels that the Kubernetes node must have, with that of its name."""
        chosen = {str(key): str(value) for key, value in self.labels.items()}
        return {**chosen, HOSTNAME: str(self.node)} if self.node else chosen

    @property
    def machine(self) -> str | None:
        """The one machine that a pod is bound to; other labels may be those of several."""
        return self.node_selector.get(HOSTNAME)


@attrs.frozen(kw_only=True)
class Placement(Machines):
    """Where a pod runs."""

    apart_from: list[str] = option("keys of `nodes` whose pods must be on other machines", [])


@attrs.frozen(kw_only=True)
class Toleration:
    """A taint that the pod tolerates, as in Kubernetes."""

    key: LabelKey | None = option("the taint's key (default: all)")
    operator: Literal["Exists", "Equal"] | None = option(
        "default: Equal if `value` is set, else Exists"
    )
    value: LabelValue | None = option("the taint's value for Equal")
    effect: Literal["NoSchedule", "PreferNoSchedule", "NoExecute"] | None = option(
        "default: all effects"
    )
    seconds: Delay | None = attrs.field(
        default=None,
        metadata={
            "aliases": ("tolerationSeconds",),
            "doc": "how long, for NoExecute (default: without limit)",
        },
    )

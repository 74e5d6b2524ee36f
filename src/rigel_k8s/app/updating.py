"""How pods are replaced: by hand-over if the gate or a lifecycle allows it, else one by one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import attrs

from rigel_k8s.app.mounts import device_of, mount_of
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import program, takes_ros_arguments
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.objects.podoptions import Readiness, RollingUpdate, Volume
from rigel_k8s.objects.pods import GATE_PORT, MASTER_NAME, Object
from rigel_k8s.objects.scalars import Share
from rigel_k8s.objects.workloads import ReleaseContext

#: On a Deployment of ROS 1, and on one of ROS 2 that hands over: how it is updated, and why.
UPDATE_ANNOTATION = "rigel-k8s/update"
#: The ROS_MASTER_URI of pods whose nodes hand over their names: the gate recognises its port.
GATE_URI = f"http://{MASTER_NAME}:{GATE_PORT}"
#: Access modes of volumes that only one machine, or only one pod, may mount.
EXCLUSIVE = ("ReadWriteOnce", "ReadWriteOncePod")


@attrs.frozen
class Way:
    """How a workload's pods are replaced.

    Attributes:
        reason: why it is not handed over, for users; "" for HandOver.
        update: the user's options for it.
        lifecycle: the full ROS name of the lifecycle node that is handed over, in ROS 2.
    """

    name: Literal["HandOver", "Recreate", "Rolling"]
    reason: str = ""
    update: RollingUpdate = attrs.field(factory=RollingUpdate)
    lifecycle: str | None = None

    @property
    def hands_over(self) -> bool:
        """Whether the new pod works only after the old one has stopped working."""
        return self.name == "HandOver"

    @property
    def strategy(self) -> Object:
        """The Deployment's strategy."""
        if self.name == "Recreate":
            return {"type": "Recreate"}
        numbers = {
            "maxSurge": share(self.update.max_surge, 1),
            "maxUnavailable": share(self.update.max_unavailable, 0),
        }
        return {"type": "RollingUpdate", "rollingUpdate": numbers}

    def annotations(self, around: ReleaseContext) -> dict[str, str]:
        """Return the annotations about a Deployment's updates."""
        if not self.lifecycle and (around.ros != "1" or not around.gate):
            return {}
        return {UPDATE_ANNOTATION: f"{self.name}: {self.reason}" if self.reason else self.name}

    def env(self, workload: str) -> dict[str, Object]:
        """Return the variables of a workload's pods."""
        if not self.hands_over:
            return {}
        if self.lifecycle:
            pod = {"fieldRef": {"apiVersion": "v1", "fieldPath": "metadata.name"}}
            return {
                "RIGEL_K8S_LIFECYCLE": {"value": self.lifecycle},
                "RIGEL_K8S_POD": {"valueFrom": pod},
            }
        warm = {"RIGEL_K8S_WARM": {"value": "1"}} if self.update.warm else {}
        named = {"RIGEL_K8S_WORKLOAD": {"value": workload}}
        return {"ROS_MASTER_URI": {"value": GATE_URI}, **named, **warm}


def is_rolling(update: RollingUpdate | None) -> bool:
    """Return whether an update by surge is requested, src.plugin's default."""
    if update is None:
        return False
    if update.strategy is None:
        return update.max_surge is not None or update.max_unavailable is not None
    return update.strategy.lower() in ("rolling", "rollingupdate")


def requests_hand_over(update: RollingUpdate | None) -> bool:
    """Return whether the user requests a hand-over."""
    return update is not None and (update.strategy or "").lower() == "handover"


def choose_way(
    around: ReleaseContext,
    update: RollingUpdate | None,
    obstacle: str | None,
    *,
    anonymous: bool = False,
    ros_name: str | None = None,
) -> Way:
    """Return how a workload is updated.

    Args:
        obstacle: why two of it cannot run, or why the gate cannot manage them; see `find_obstacle`
            and `find_lifecycle_obstacle`.
        ros_name: the full name of the node, if it is known.
    """
    asked = update or RollingUpdate()
    if is_rolling(update):
        return Way("Rolling", "`update` requests it", asked)
    if asked.strategy is not None and asked.strategy.lower() == "recreate":
        return Way("Recreate", "`update` requests it", asked)
    if anonymous:
        return Way("Rolling", "its ROS name differs in each pod", asked)
    if around.ros != "1":
        if requests_hand_over(update) and ros_name and not obstacle:
            return Way("HandOver", "", asked, ros_name)
        return Way("Recreate", "only lifecycle nodes can be handed over in DDS", asked)
    if not around.gate:
        return Way("Recreate", "roscore has no gate", asked)
    return Way("Recreate", obstacle, asked) if obstacle else Way("HandOver", "", asked)


def find_lifecycle_obstacle(
    node: NodeOptions,
    volumes: Mapping[str, Volume],
    network: Network | None,
    middleware: str | None,
) -> str | None:
    """Return why a lifecycle node of ROS 2 cannot be handed over to another pod.

    Args:
        volumes: the release's persistent volumes, by name.
    """
    if node.ros == "none":
        return "it has no ROS"
    if node.launch:
        return "a launch file gives its nodes their names: use package and executable, or args"
    if node.lifecycle:
        return "it makes the transitions of `lifecycle`: remove one of the two"
    if node.components:
        return "its components are loaded again, and would run beside those of the old pod"
    try:
        line = program("2", node)
    except ValueError:
        return "its command line cannot be split into words"
    if not takes_ros_arguments("2", line):
        return "its services get names of their own, by arguments that only a program takes"
    if network is not None:
        mode = mode_of(network)
        middleware = mode.middleware or middleware
        if mode.in_machine_network:
            return "it uses the machine's own network"
        if network.ipam == "static":
            return "with `ipam: static` two pods would have one address"
        if mode.one_pod:
            return f"with `{network.mode}` the two pods do not find each other"
    if middleware == "zenoh":
        return "hand-over needs DDS, and this is zenoh"
    return find_obstacle(node, volumes, ready_by=(None, "ros", "dds"))


def find_obstacle(
    node: NodeOptions,
    volumes: Mapping[str, Volume],
    *,
    own_master: bool = False,
    ready_by: Sequence[str | None] = (None, "ros"),
) -> str | None:
    """Return why two pods of a node cannot run side by side, or the gate cannot manage them.

    Args:
        volumes: the release's persistent volumes, by name.
        own_master: the network gives it a ROS_MASTER_URI of its own.
        ready_by: the readiness checks that support hand-overs.
    """
    found = {
        "it has a readiness check of its own": node.readiness not in ready_by,
        "it has a ROS_MASTER_URI of its own": own_master or has_variable(node, "ROS_MASTER_URI"),
    }
    own = next((reason for reason, holds in found.items() if holds), None)
    return find_own_machine(node) or own or find_shared(node, volumes)


def find_clash(node: NodeOptions, volumes: Mapping[str, Volume]) -> str | None:
    """Return why two pods of a node disturb each other, even if their ROS names differ."""
    return find_own_machine(node) or find_shared(node, volumes)


def find_own_machine(node: NodeOptions) -> str | None:
    """Return what a node has of its machine that two pods cannot use side by side."""
    device = next((d.path or d.resource for d in map(device_of, node.devices)), None)
    found = {
        f"it has the device {device}": bool(node.devices),
        "it uses the machine's own network": node.host_network,
        "it is privileged": bool(node.security_context.get("privileged")),
    }
    return next((reason for reason, holds in found.items() if holds), None)


def find_shared(node: NodeOptions, volumes: Mapping[str, Volume]) -> str | None:
    """Return why a node's volumes, or its patch, prevent two pods from running side by side."""
    mounted = [mount_of(item) for item in node.volumes]
    claims = [volumes[str(m.name)] for m in mounted if m.name and str(m.name) in volumes]
    return find_exclusive(claims) or find_patched(node.patch)


def has_variable(node: NodeOptions, name: str) -> bool:
    """Return whether the user sets an environment variable."""
    if isinstance(node.env, Mapping):
        return name in {str(key) for key in node.env}
    return name in {str(one.name) for one in node.env}


def find_exclusive(volumes: Iterable[Volume]) -> str | None:
    """Return why a volume cannot be mounted by two pods."""
    for volume in volumes:
        if volume.access_mode in EXCLUSIVE:
            return f"its volume {volume.name} is {volume.access_mode}"
    return None


def find_application_obstacle(
    readiness: Readiness | str | None,
    volumes: Sequence[Volume],
    params: Mapping[str, Any],
    *,
    own_master: bool,
) -> str | None:
    """Return why two pods of src.plugin's one application cannot run side by side."""
    if readiness not in (None, "ros"):
        return "it has a readiness check of its own"
    if own_master:
        return "it has a ROS_MASTER_URI of its own"
    return find_exclusive(volumes) or find_patched(params)


def find_patched(patch: Mapping[str, Any]) -> str | None:
    """Return why a user's own part of a Deployment prevents two pods from running side by side."""
    spec = mapping(mapping(mapping(patch.get("spec")).get("template")).get("spec"))
    if spec.get("hostNetwork"):
        return "it uses the machine's own network"
    for container in list_mappings(spec.get("containers")):
        if mapping(container.get("securityContext")).get("privileged"):
            return "it is privileged"
        if any("hostPort" in port for port in list_mappings(container.get("ports"))):
            return "it has a port of its machine"
    if any("persistentVolumeClaim" in one for one in list_mappings(spec.get("volumes"))):
        return "it mounts a claim that may be exclusive"
    return None


def mapping(value: Any) -> Mapping[str, Any]:
    """Return a mapping; an empty one for anything else."""
    return value if isinstance(value, Mapping) else {}


def list_mappings(value: Any) -> Iterator[Mapping[str, Any]]:
    """Yield the mappings of a list."""
    items = value if isinstance(value, list | tuple) else ()
    yield from (one for one in items if isinstance(one, Mapping))


def share(value: Share | None, default: int) -> int | str:
    """Return a number of pods, or a percentage, for the Kubernetes field."""
    return default if value is None else value.value

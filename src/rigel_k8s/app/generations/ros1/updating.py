"""How nodes of ROS 1 are replaced: the gate in front of roscore hands their names over."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.app.generations.ros1.gate import has_gate
from rigel_k8s.app.generations.ros1.master import deploys_master
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.updating import Way, find_obstacle, has_variable
from rigel_k8s.network.options import Network
from rigel_k8s.objects.podoptions import RollingUpdate, Volume
from rigel_k8s.objects.pods import GATE_PORT, MASTER_NAME
from rigel_k8s.objects.workloads import ReleaseContext

#: The ROS_MASTER_URI of pods whose nodes hand over their names: the gate recognises its port.
GATE_URI = f"http://{MASTER_NAME}:{GATE_PORT}"


def find_own_obstacle(
    node: NodeOptions,
    volumes: Mapping[str, Volume],
    network: Network | None,
    middleware: str | None,
) -> str | None:
    """Return why two pods of a node cannot run side by side, or the gate cannot manage them."""
    static = network is not None and network.ipam == "static"
    obstacle = find_obstacle(node, volumes, (None, "ros"))
    if static or has_variable(node, "ROS_MASTER_URI"):
        return obstacle or "it has a ROS_MASTER_URI of its own"
    return obstacle


def choose_way(
    release: ReleaseContext,
    workload: str,
    ros_name: str | None,
    update: RollingUpdate,
    obstacle: str | None,
) -> Way:
    """Return HandOver where the gate can do it."""
    if not release.gate:
        return Way("Recreate", "roscore has no gate", update)
    if obstacle:
        return Way("Recreate", obstacle, update)
    env = {
        "ROS_MASTER_URI": {"value": GATE_URI},
        "RIGEL_K8S_WORKLOAD": {"value": workload},
    }
    return Way("HandOver", "", update, env)


def refuse_hand_over(options: OrchestrationOptions, distro: str) -> str | None:
    """Return why no node of a job can be handed over."""
    gate = deploys_master(options) and has_gate(options, distro)
    return None if gate else "roscore has no gate, see `gate`"

"""ROS 1: nodes register with roscore, a workload of its own, with a gate in front of it.

The gate's program is the house `rigel_gate`. With it, this folder, and its line in generation.py,
ROS 1 is gone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import attrs

from rigel_k8s.app.generations.ros1 import checks, commands
from rigel_k8s.app.generations.ros1.binding import bind
from rigel_k8s.app.generations.ros1.gate import has_gate, remedies_of
from rigel_k8s.app.generations.ros1.globalparameters import setter_of
from rigel_k8s.app.generations.ros1.master import deploys_master, image_of, master_of, master_uri
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import list_global_keys
from rigel_k8s.app.updating import Way, find_obstacle, has_variable
from rigel_k8s.generation import Companion, Generation, Object
from rigel_k8s.network.options import Network
from rigel_k8s.objects.podoptions import RollingUpdate, Volume
from rigel_k8s.objects.pods import GATE_PORT, MASTER_NAME
from rigel_k8s.objects.rosnames import NAMES_1
from rigel_k8s.objects.workloads import ReleaseContext

if TYPE_CHECKING:
    from rigel_k8s.discovery.members import Member
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.types import ReleaseId
    from rigel_k8s.rosgraph.handover import GateStatus
    from rigel_k8s.rosgraph.pods import GraphPod
    from rigel_k8s.rosgraph.types import RosGraph

#: The ROS_MASTER_URI of pods whose nodes hand over their names: the gate recognises its port.
GATE_URI = f"http://{MASTER_NAME}:{GATE_PORT}"


def variables(release: ReleaseContext, namespace: str | None, address: str) -> dict[str, Object]:
    """Return the variables of a container.

    ROS_IP makes a node advertise an address that other pods reach: a pod's name resolves nowhere.
    The rest makes rospy and roscpp log at once.
    """
    return {
        "ROS_MASTER_URI": {"value": release.master_uri},
        "ROS_IP": {"valueFrom": {"fieldRef": {"apiVersion": "v1", "fieldPath": address}}},
        "ROS_NAMESPACE": {"value": namespace},
        "PYTHONUNBUFFERED": {"value": "1"},
        "ROSCONSOLE_STDOUT_LINE_BUFFERED": {"value": "1"},
    }


def in_context(release: ReleaseContext, options: OrchestrationOptions) -> ReleaseContext:
    """Return a release's context with its master."""
    gate = deploys_master(options) and has_gate(options, release.distro)
    return attrs.evolve(release, master_uri=master_uri(options), gate=gate)


def companions(options: OrchestrationOptions, distro: str) -> list[Companion]:
    """Return roscore, and what sets global parameters at it."""
    found = [master_of(options, distro)] if deploys_master(options) else []
    if list_global_keys(options):
        found.append(setter_of(options, image_of(options, distro)))
    return found


def find_own_obstacle(
    node: NodeOptions,
    volumes: Mapping[str, Volume],
    network: Network | None,
    middleware: str | None,
) -> str | None:
    """Return why two pods of a node cannot run side by side, or the gate cannot manage them."""
    static = network is not None and network.ipam == "static"
    obstacle = find_obstacle(node, volumes, network, (None, "ros"))
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


def read_program() -> Mapping[str, str]:
    """Return the gate's files."""
    from rigel_gate.program import program

    return program()


def read_graph(
    cluster: Cluster, pods: Sequence[GraphPod], members: Sequence[Member], span: float
) -> RosGraph:
    """Return the graph of the master."""
    from rigel_k8s.rosgraph.ros1 import read

    return read(cluster, pods, span)


def read_gate(cluster: Cluster, release: ReleaseId) -> GateStatus | None:
    """Return what the gate answers."""
    from rigel_k8s.rosgraph.ros1 import read_gate as read

    return read(cluster, release)


ROS1 = Generation(
    name="1",
    title="ROS 1",
    names=NAMES_1,
    dds=False,
    prepares_home=True,
    clash="shut each other down",
    surge="during an update two pods of one ROS name run at once, and the ROS master shuts one of"
    " them down; leave `strategy` out, and a node hands its name over, or stops for its update",
    hands_over=True,
    program=commands.program,
    takes_arguments=commands.takes_arguments,
    command_of=commands.command_of,
    variables=variables,
    probe=lambda plan: ("node",),
    components=commands.NODELETS,
    find_obstacle=find_own_obstacle,
    choose_way=choose_way,
    refuse_hand_over=refuse_hand_over,
    check=checks.check,
    check_parameters=checks.check_names,
    check_parameter_file=commands.check_parameter_file,
    explain_unreadable=checks.explain_unreadable,
    explain_unseen=checks.explain_unseen,
    in_context=in_context,
    companions=companions,
    read_program=read_program,
    bind=bind,
    remedies=remedies_of,
    read_graph=read_graph,
    read_gate=read_gate,
    starter={
        "status": "what runs where, and what is wrong with it",
        "distro": "noetic",
        "workspace": "catkin",
        "run": "rosrun",
        "package": "rospy_tutorials",
        "apt": "ros-noetic-rospy-tutorials",
        "rate": "10",
        "deploys": """\
  # Deploys a ROS master and the nodes, each in a pod of its own, and waits until they are ready.
""",
        "network": "      deploy_ros_master: true\n",
    },
)

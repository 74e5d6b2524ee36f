"""ROS 1: nodes register with roscore, a workload of its own, with a gate in front of it.

The gate's program is the house `rigel_gate`. With it, this folder, and its lines in
ros.py and app/generation.py, ROS 1 is gone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import attrs

from rigel_k8s.app.checks.commands import IN_PARAMETERS, check_parameter_options, check_substitution
from rigel_k8s.app.command import Command
from rigel_k8s.app.generation import Companion, Generation
from rigel_k8s.app.generations.ros1 import commands
from rigel_k8s.app.generations.ros1.gate import has_gate, remedies_of
from rigel_k8s.app.generations.ros1.globalparameters import setter_of
from rigel_k8s.app.generations.ros1.master import (
    bind,
    deploys_master,
    image_of,
    master_of,
    master_uri,
)
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import Fault, ParameterOptions, flat_values, list_global_keys
from rigel_k8s.app.programs import explain_not_passed
from rigel_k8s.app.updating import Candidate, Way, find_obstacle, has_variable
from rigel_k8s.network.options import Network
from rigel_k8s.objects.podoptions import Volume
from rigel_k8s.objects.pods import GATE_PORT, MASTER_NAME, Object
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.rosnames import NAMES_1
from rigel_k8s.objects.scalars import RosName
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.problems import Problem
from rigel_k8s.ros import ROS_1

#: The ROS_MASTER_URI of pods whose nodes hand over their names: the gate recognises its port.
GATE_URI = f"http://{MASTER_NAME}:{GATE_PORT}"
NO_MASTER = (
    "ros_metrics: the exporter needs a ROS master that other pods reach: set ros_master_uri, remove"
    " deploy_ros_master, or set `ros_metrics: false`"
)


@attrs.frozen(kw_only=True)
class Ros1(Generation):
    """Nodes of ROS 1."""

    names = NAMES_1
    clash = "shut each other down"
    surge = (
        "during an update two pods of one ROS name run at once, and the ROS master shuts one of"
        " them down; leave `strategy` out, and a node hands its name over, or stops for its update"
    )
    components = commands.NODELETS
    starter: ClassVar[Mapping[str, str]] = {
        "status": "what runs where, and what is wrong with it",
        "distro": "noetic",
        "workspace": "catkin",
        "run": "rosrun",
        "package": "rospy_tutorials",
        "apt": "rospy-tutorials",
        "rate": "10",
        "deploys": """\
  # Deploys a ROS master and the nodes, each in a pod of its own, and waits until they are ready.
""",
        "network": "      deploy_ros_master: true\n",
    }

    def program(self, node: NodeOptions) -> list[str]:
        """Return the program and its own arguments; empty for the image's CMD."""
        return commands.program(node)

    def takes_arguments(self, line: Sequence[str]) -> bool:
        """Whether remappings can be appended to a line."""
        return commands.takes_arguments(line)

    def command_of(self, key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
        """Return what a node's container runs."""
        return commands.command_of(key, node, files)

    def variables(
        self, release: ReleaseContext, namespace: str | None, address: str
    ) -> dict[str, Object]:
        """Return the variables of a container.

        ROS_IP makes a node advertise an address that other pods reach: a pod's name resolves
        nowhere. The rest makes rospy and roscpp log at once.
        """
        return {
            "ROS_MASTER_URI": {"value": release.master_uri},
            "ROS_IP": {"valueFrom": {"fieldRef": {"apiVersion": "v1", "fieldPath": address}}},
            "ROS_NAMESPACE": {"value": namespace},
            "PYTHONUNBUFFERED": {"value": "1"},
            "ROSCONSOLE_STDOUT_LINE_BUFFERED": {"value": "1"},
        }

    def find_obstacle(
        self,
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

    def hand_over(self, candidate: Candidate) -> Way:
        if not candidate.release.gate:
            return Way("Recreate", "roscore has no gate", candidate.update)
        if candidate.obstacle:
            return Way("Recreate", candidate.obstacle, candidate.update)
        env = {
            "ROS_MASTER_URI": {"value": GATE_URI},
            "RIGEL_K8S_WORKLOAD": {"value": candidate.workload},
        }
        return Way("HandOver", "", candidate.update, env)

    def refuse_hand_over(self, options: OrchestrationOptions, distro: str) -> str | None:
        """Return why no node of a job can be handed over."""
        gate = deploys_master(options) and has_gate(options, distro)
        return None if gate else "roscore has no gate, see `gate`"

    def check(self, options: OrchestrationOptions) -> Iterator[Problem]:
        """Yield what is wrong with the master and the global parameters of a job."""
        if options.deploy_ros_master and options.ros_master_uri:
            message = (
                "ros_master_uri names a master, but deploy_ros_master deploys another: remove one"
            )
            yield Problem(("ros_master_uri",), message, "two-masters", at_key=True)
        if self.explain_unseen(options) and options.nodes:
            message = (
                "no ROS master: each node searches for one in its own container;"
                " set ros_master_uri if there is one"
            )
            yield Problem(("deploy_ros_master",), message, "no-master", severity="warning")
        if options.deployment_name == MASTER_NAME:
            yield Problem(("deployment_name",), f'"{MASTER_NAME}" is roscore\'s name', "name-taken")
        if options.middleware:
            message = "ROS 1 has no middleware to choose: remove it"
            yield Problem(("middleware",), message, "ros1", at_key=True)
        if options.substitution_args and not list_global_keys(options):
            message = (
                "this job has no global parameters with substitution args: set substitution_args of"
                " the nodes that need it"
            )
            path = ("substitution_args",)
            yield Problem(path, message, "incomplete", severity="warning", at_key=True)
        yield from check_parameter_options(options, self)
        yield from check_substitution(options, IN_PARAMETERS)

    def check_parameters(self, options: ParameterOptions) -> Iterator[Problem]:
        """Yield parameters that are not ROS names, and values that are none of XML-RPC."""
        yield from commands.check_values(options)
        for key, name, _ in flat_values(options.parameters):
            yield from check_parameter_name(("parameters", key), name)
        for key in map(str, options.parameter_commands):
            yield from check_parameter_name(("parameter_commands", key), key.lstrip("~"))

    def check_parameter_file(
        self, text: str, key: str | None, options: ParameterOptions
    ) -> Iterator[Fault]:
        """Yield values that are none of XML-RPC."""
        return commands.check_parameter_file(text, key, options)

    def explain_unreadable(self, node: NodeOptions, key: str) -> str | None:
        """Return why a node does not read one of its options."""
        loaded = key in ("parameter_files", "parameter_commands")  # by our own scripts
        if node.launch:
            where = "launch.args" if key == "parameters" else "the launch file"
            message = f"roslaunch does not read {key} from its command line: write them in {where}"
            return None if loaded else message
        if loaded:
            unknown = "the name of an anonymous node is unknown before it starts: use parameters"
            return unknown if node.anonymous else None
        line = self.program(node)
        return None if self.takes_arguments(line) else explain_not_passed(line, key)

    def explain_unseen(self, options: OrchestrationOptions) -> str | None:
        """Return why an exporter would see nothing: no master that it reaches."""
        alone = options.deploy_ros_master is False and options.ros_master_uri is None
        return NO_MASTER if alone else None

    def in_context(self, release: ReleaseContext, options: OrchestrationOptions) -> ReleaseContext:
        """Return a release's context with its master."""
        gate = deploys_master(options) and has_gate(options, release.distro)
        return attrs.evolve(release, master_uri=master_uri(options), gate=gate)

    def companions(self, options: OrchestrationOptions, distro: str) -> Sequence[Companion]:
        """Return roscore, and what sets global parameters at it."""
        found = [master_of(options, distro)] if deploys_master(options) else []
        if list_global_keys(options):
            found.append(setter_of(options, image_of(options, distro)))
        return found

    def read_program(self) -> Mapping[str, str]:
        """Return the gate's files."""
        from rigel_gate.program import program

        return program()

    def bind(self, made: Sequence[Manifest]) -> Sequence[Manifest]:
        """Return objects whose pods restart with a roscore that forgets them."""
        return bind(made)

    def remedies(self, made: Sequence[Object]) -> Mapping[str, str]:
        """Return what to do without the rights that the gate's account gets."""
        return remedies_of(made)


def check_parameter_name(path: tuple[str, ...], name: str) -> Iterator[Problem]:
    """Yield why a parameter cannot have a name."""
    try:
        RosName.parse(name)
    except ValueError as error:
        yield Problem(path, str(error), RosName.kind, at_key=True)
    else:
        message = ""
        if name == "/":
            message = "/ is a namespace: add the parameter's name"
        elif name.startswith("_"):
            message = (
                f"the mark of a command line is not a part of the name: write {name.lstrip('_')}"
            )
        if message:
            yield Problem(path, message, RosName.kind, at_key=True)


ROS1 = Ros1.of(ROS_1)

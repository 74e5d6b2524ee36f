"""ROS 2: nodes discover each other by DDS or zenoh, and read --ros-args.

Parameters always travel in files: on a command line "1.10" would become a number, and lists need
quoting that shells and launch files undo.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, ClassVar

import attrs
import yaml

from rigel_k8s.app.command import Command
from rigel_k8s.app.components import dotted
from rigel_k8s.app.generation import Generation, Loading
from rigel_k8s.app.generations.dds import check_masterless, explain_zenoh
from rigel_k8s.app.generations.ros2files import (
    ANY_NODE,
    PARAMETERS,
    check_file,
    nest_parameters,
)
from rigel_k8s.app.layer import NOT_BUILT, drain_seconds, explain_left_out, hand_over_variables
from rigel_k8s.app.options import Component, NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import (
    PARAMETERS_PATH,
    Fault,
    ParameterOptions,
    file_of,
    flat_values,
    is_list_of_one_type,
    list_local,
    list_paths,
    unify_lists,
)
from rigel_k8s.app.programs import (
    NO_ROS_ARGUMENTS,
    assignments,
    begin,
    explain_not_passed,
    full_name,
    list_run_steps,
    load_values,
    needs_script,
    split,
    write_values,
)
from rigel_k8s.app.updating import Candidate, OnRequest, Way, find_obstacle, requests_hand_over
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.objects.podoptions import Volume
from rigel_k8s.objects.pods import LOG_PATH, Object
from rigel_k8s.objects.rosnames import NAMES_2
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem
from rigel_k8s.ros import CURRENT, ROS_2, ROS_ARGS, ROS_ARGS_END
from rigel_k8s.substitution_args import has_substitution
from rigel_k8s.yaml_text import Dumper
from rigel_rmw import libraries

#: What loads components if a node has no program of its own.
CONTAINER = ("ros2", "run", "rclcpp_components", "component_container")
UNPROVEN = OnRequest("hand-over was not run over zenoh")
#: The node's own `parameters`, as rcl reads them.
OWN_FILE = "99-parameters.yaml"


def rules(key: str, node: NodeOptions) -> Iterator[str]:
    """Yield remapping rules: the node's name and namespace, then the user's own."""
    namespace, _, name = full_name(key, node).rpartition("/")
    if node.anonymous:
        namespace = "/" + str(node.namespace or "").strip("/")
    else:
        yield f"__node:={name}"
    if namespace.strip("/"):
        yield f"__ns:={namespace}"
    yield from assignments(node.remappings)


def reads_ros_arguments(line: Sequence[str]) -> bool:
    """Return whether the end of a line is already read as ROS arguments."""
    marks = [word for word in line if word in (ROS_ARGS, ROS_ARGS_END)]
    return marks[-1:] == [ROS_ARGS]


def render_files(node: NodeOptions, files: Mapping[str, str]) -> dict[str, str]:
    """Return the files to mount, in the order of loading; `parameters` win over files."""
    found = {name: nest_parameters(files[path]) for name, path in list_local(node)}
    later = {
        name: value
        for name, value in node.parameters.items()
        if node.substitution_args and has_substitution(value)
    }
    now = {name: value for name, value in node.parameters.items() if name not in later}
    if now:
        own = {ANY_NODE: {PARAMETERS: quote_texts(unify_lists(now))}}
        found[OWN_FILE] = yaml.dump(own, Dumper=ParameterDumper, sort_keys=True, width=2**20)
    if later:
        found |= write_values(unify_lists(later))
    return found


class QuotedText(str):
    """A text that is written in quotes."""


class ParameterDumper(Dumper):  # type: ignore[misc]  # Any: with or without LibYAML
    """Writes YAML for rcl."""


ParameterDumper.add_representer(
    QuotedText,
    lambda dumper, text: dumper.represent_scalar("tag:yaml.org,2002:str", str(text), style='"'),
)


def quote_texts(value: Any) -> Any:
    """Return parameters whose texts are quoted: rcl reads `y` and `12e5` as other types."""
    if isinstance(value, str):
        return QuotedText(value)
    if isinstance(value, Mapping):
        return {key: quote_texts(inner) for key, inner in value.items()}
    return [quote_texts(inner) for inner in value] if isinstance(value, list) else value


def describe_component(key: str, component: Component) -> dict[str, Any]:
    """Return a composable node for components.py: dotted parameters, remapping rules."""
    return {
        "name": component.full_name(key),
        "package": component.package,
        "plugin": component.plugin,
        "parameters": dict(dotted(component.parameters)),
        "remappings": [f"{one}:={other}" for one, other in component.remappings.items()],
        "extra_arguments": dict(component.extra_arguments),
    }


def check_composable(component: Component) -> Iterator[Problem]:
    """Yield what a composable node needs, and parameters without a type."""
    if component.package is None:
        message = f"the package of {component.plugin} is missing: add `package`"
        yield Problem((), message, "incomplete", at_key=True)
    if "/" in component.plugin and not has_template(component.plugin):
        message = f"in ROS 2 a class is written {component.plugin.replace('/', '::')}"
        yield Problem(("plugin",), message, "bad-plugin")
    for key, value in component.parameters.items():
        for name, inner in dotted({key: value}):
            if reason := explain_parameter(name, inner):
                yield Problem(("parameters", key), reason, "bad-parameter", at_key=True)


def explain_parameter(name: str, value: Any) -> str | None:
    """Return why rcl has no type for a parameter's value, None if it has one."""
    if PARAMETERS in name:
        return (
            f"`parameters` has names and values only: leave {PARAMETERS} and what is above it out"
        )
    if name.startswith("~"):
        return f"ROS 2 has no private names of parameters: write {name.lstrip('~/')}"
    if value is None or isinstance(value, Mapping):  # an empty one, which is all that is left
        return f'the parameter "{name}" has no value'
    inner = value if isinstance(value, list) else [value]
    if any(isinstance(one, int) and not -(2**63) <= one < 2**63 for one in inner):
        return f'the parameter "{name}" has a number of more than 64 bits: write it as a text'
    if value == []:
        return f'the list "{name}" is empty, so that ROS 2 has no type for it: leave it out'
    if isinstance(value, list) and not is_list_of_one_type(value):
        return f'the list "{name}" must have values of one type'
    return None


@attrs.frozen(kw_only=True)
class Ros2(Generation):
    """Nodes of ROS 2."""

    names = NAMES_2
    lifecycle = True
    clash = "answer each other's services and parameters"
    surge = (
        "during an update two nodes of one name run at once: each of their messages comes twice,"
        " and either answers services and actions; leave `strategy` out, and a node hands over, or"
        " stops for its update"
    )
    components = Loading(
        script="components.py",
        describe=describe_component,
        check=check_composable,
        are_nodes=True,
        twice="in a rolling update the containers of both pods would load them: use Recreate",
    )
    starter: ClassVar[Mapping[str, str]] = {
        "status": "what runs where, who has discovered whom, and what is wrong",
        "distro": CURRENT,
        "workspace": "colcon",
        "run": "ros2, run",
        "package": "demo_nodes_cpp",
        "apt": "demo-nodes-cpp",
        "rate": "10.0",
        "deploys": """\
  # Deploys the nodes, each in a pod of its own, waits until they are ready, and checks that they
  # discover each other.
""",
        "network": """\
      # Pod networks carry no multicast between machines. peers works on any cluster; macvlan puts
      # the nodes onto the machines' Ethernet, where laptops see them too:
      # network: {mode: macvlan, interface: eth0, subnet: 10.20.0.0/24, install: true}
      network: peers
""",
    }

    def program(self, node: NodeOptions) -> list[str]:
        """Return the program and its own arguments; empty for the image's CMD."""
        own = split(node, node.args or [])
        if node.launch:
            package = [node.launch.package] if node.launch.package else []
            return ["ros2", "launch", *package, node.launch.file, *assignments(node.launch.args)]
        if node.package:
            return ["ros2", "run", node.package, node.executable or "", *own]
        line = split(node, node.command) if node.command is not None else own
        return line or list(CONTAINER if node.components else ())

    def takes_arguments(self, line: Sequence[str]) -> bool:
        """Return whether --ros-args can be appended to a command line."""
        if not line:
            return False
        name = PurePosixPath(line[0]).name
        if name == "ros2":
            return list(line[1:2]) == ["run"]
        return name not in NO_ROS_ARGUMENTS

    def command_of(self, key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
        """Return what a node's container runs.

        Args:
            key: the node's key in `nodes`.
            files: the texts of its parameter files, by the names in `parameter_files`.
        """
        mounted = render_files(node, files)
        line = self.program(node)
        line += self.ros_arguments(key, node, line, mounted)
        if not line:
            return Command()
        start: tuple[str, ...] = ()
        if needs_script(node):
            steps = (*load_values(mounted, ANY_NODE), *list_run_steps(node))
            start = (*begin("ros2", node, node.env), *steps)
        if node.command is not None:
            return Command(command=line, files=mounted, start=start)
        return Command(args=line, files=mounted, start=start)

    def ros_arguments(
        self, key: str, node: NodeOptions, line: Sequence[str], mounted: Mapping[str, str]
    ) -> list[str]:
        """Return what is appended to a line for ROS: names, remappings, parameter files."""
        if node.launch or not self.takes_arguments(line):
            return []
        found = [word for rule in rules(key, node) for word in ("-r", rule)]
        paths = [path for path, _ in list_paths(node)]
        if OWN_FILE in mounted:
            paths.append(f"{PARAMETERS_PATH}/{OWN_FILE}")
        found += [word for path in paths for word in ("--params-file", path)]
        if not found or reads_ros_arguments(line):
            return found
        return [ROS_ARGS, *found]

    def variables(
        self, release: ReleaseContext, namespace: str | None, address: str
    ) -> dict[str, Object]:
        """Return the variables of a container.

        They make rclpy and rclcpp log at once, plainly and to one stream; rcl does not start if it
        cannot write a log directory, for example with another user or a read-only root.
        """
        return {
            "PYTHONUNBUFFERED": {"value": "1"},
            "RCUTILS_COLORIZED_OUTPUT": {"value": "0"},
            "RCUTILS_LOGGING_USE_STDOUT": {"value": "1"},
            "RCUTILS_LOGGING_BUFFERED_STREAM": {"value": "1"},
            "ROS_LOG_DIR": {"value": LOG_PATH},
        }

    def find_obstacle(
        self,
        node: NodeOptions,
        volumes: Mapping[str, Volume],
        network: Network | None,
        middleware: str | None,
    ) -> str | None:
        """Return why a node cannot be handed over to another pod."""
        try:
            left_out = explain_left_out(node, self.program(node))
        except ValueError:
            return "its command line cannot be split into words"
        if left_out:
            return left_out
        if node.replicas is not None and int(node.replicas) > 1:
            return f"it has {node.replicas} pods"
        if network is not None and network.ipam == "static":
            return "with `ipam: static` two pods would have one address"
        used = middleware or (network and mode_of(network).middleware)
        if used == "zenoh" and not requests_hand_over(node.update):
            return UNPROVEN
        return find_obstacle(node, volumes, network, (None, "ros", "dds"), shares_network=True)

    def hand_over(self, candidate: Candidate) -> Way:
        """Return HandOver where the layer can do it; see docs/ros2-updates.md."""
        update = candidate.update
        if not candidate.release.layer:
            return Way("Recreate", NOT_BUILT, update)
        if candidate.obstacle:
            return Way("Recreate", candidate.obstacle, update)
        env = hand_over_variables(candidate)
        return Way("HandOver", "", update, env, drain_seconds(update))

    def refuse_hand_over(self, options: OrchestrationOptions, distro: str) -> str | None:
        """Return why no node of a job can be handed over."""
        return None if libraries() else NOT_BUILT

    def check(self, options: OrchestrationOptions) -> Iterator[Problem]:
        """Yield options for a master, which it has not."""
        return check_masterless(options, self.title)

    def check_parameters(self, options: ParameterOptions) -> Iterator[Problem]:
        """Yield lists and namespaces of parameters that ROS 2 does not have."""
        for key, name, value in flat_values(options.parameters):
            full = key if key.startswith("~") else name.replace("/", ".")
            if reason := explain_parameter(full, value):
                yield Problem(("parameters", key), reason, "bad-parameter", at_key=True)
        for index, entry in enumerate(map(file_of, options.parameter_files)):
            if entry.namespace is not None:
                path = ("parameter_files", index, "namespace")
                message = (
                    "ROS 2 has no namespaces of parameters: write the names in full in the file"
                )
                yield Problem(path, message, "no-parameter-namespace", at_key=True)

    def check_parameter_file(
        self, text: str, key: str | None, node: ParameterOptions
    ) -> Iterator[Fault]:
        """Yield what is wrong with a file of a node; a launch file may change it first."""
        if key is None or not isinstance(node, NodeOptions) or node.launch:
            return
        name = None if node.anonymous else full_name(key, node)
        parts = [one.full_name(part) for part, one in node.components.items()]
        yield from check_file(text, name, parts)

    def explain_unreadable(self, node: NodeOptions, key: str) -> str | None:
        """Return why a node could not read the key's value, None if it can."""
        if node.launch:
            if key != "parameter_files":
                where = "launch.args" if key == "parameters" else "the launch file"
                return (
                    f"ros2 launch does not read {key} from its command line: write them in {where}"
                )
            if any(PARAMETERS_PATH in str(value) for value in node.launch.args.values()):
                return None
            path, _ = next(list_paths(node))
            return f"ros2 launch does not read parameter files: pass them in launch.args, as {path}"
        line = self.program(node)
        return None if self.takes_arguments(line) else explain_not_passed(line, key)

    def explain_unseen(self, options: OrchestrationOptions) -> str | None:
        """Return why an exporter would see nothing; notes are read in every middleware."""
        return None if libraries() and options.rmw_layer is not False else explain_zenoh(options)


ROS2 = Ros2.of(ROS_2)

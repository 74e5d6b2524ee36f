"""What is wrong with options that only ROS 1 has, or reads differently; pure."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.generations.ros1.commands import check_values, program, takes_arguments
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import ParameterOptions, flat_values, list_global_keys
from rigel_k8s.app.programs import explain_not_passed
from rigel_k8s.objects.pods import MASTER_NAME
from rigel_k8s.objects.scalars import RosName
from rigel_k8s.problems import Problem

NO_MASTER = (
    "ros_metrics: the exporter needs a ROS master that other pods reach: set ros_master_uri, remove"
    " deploy_ros_master, or set `ros_metrics: false`"
)


def check(options: OrchestrationOptions) -> Iterator[Problem]:
    """Yield what is wrong with the master and the global parameters of a job."""
    if options.deploy_ros_master and options.ros_master_uri:
        message = "ros_master_uri names a master, but deploy_ros_master deploys another: remove one"
        yield Problem(("ros_master_uri",), message, "two-masters", at_key=True)
    if explain_unseen(options) and options.nodes:
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
            "this job has no global parameters with substitution args: set substitution_args of the"
            " nodes that need it"
        )
        path = ("substitution_args",)
        yield Problem(path, message, "incomplete", severity="warning", at_key=True)


def explain_unseen(options: OrchestrationOptions) -> str | None:
    """Return why an exporter would see nothing: each node's master is in its own container."""
    alone = options.deploy_ros_master is False and options.ros_master_uri is None
    return NO_MASTER if alone else None


def check_parameter_names(options: ParameterOptions) -> Iterator[Problem]:
    """Yield names of parameters that are not ROS names, and values that are none of XML-RPC."""
    yield from check_values(options)
    for key, name, _ in flat_values(options.parameters):
        yield from check_parameter_name(("parameters", key), name)
    for key in map(str, options.parameter_commands):
        yield from check_parameter_name(("parameter_commands", key), key.lstrip("~"))


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


def explain_unreadable(node: NodeOptions, key: str) -> str | None:
    """Return why a node could not read the key's value, None if it can."""
    loaded = key in ("parameter_files", "parameter_commands")  # by our own scripts
    if node.launch:
        where = "launch.args" if key == "parameters" else "the launch file"
        message = f"roslaunch does not read {key} from its command line: write them in {where}"
        return None if loaded else message
    if loaded:
        unknown = "the name of an anonymous node is unknown before it starts: use parameters"
        return unknown if node.anonymous else None
    line = program(node)
    return None if takes_arguments(line) else explain_not_passed(line, key)

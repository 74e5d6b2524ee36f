"""What a launch file of ROS 2 would start, found by visiting its actions; none of them is started.

It runs in an image, with that image's launch and launch_ros (humble and newer) and nothing else,
and imports no module of this package: `python3 -c SCRIPT REQUEST`. Its output is one JSON document
between two lines; what the launch file and its programs print goes to standard error.

Each action does its work itself, so that arguments, conditions, groups, includes and substitutions
are those of ROS. Only those that start, wait or send something are replaced: see `replace`.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import shlex
import sys
import tempfile
import traceback
from pathlib import Path
from types import FrameType
from typing import Any, Callable, Iterable

BEGIN, END = "--- rigel: launch file begins ---", "--- rigel: launch file ends ---"
#: The first and last character of a word that stands for an executable of a package.
MARK = "\ue000"
#: The packages whose code is not a launch file's.
OWN = ("__main__", "contextlib", "launch", "launch_ros", "launch_xml", "launch_yaml")

#: The document: see `evaluate`.
found: dict[str, Any] = {"arguments": [], "commands": {}, "components": []}
found.update(processes=[], remarks=[])
#: What the actions that are visited now wait for in the launch file.
waiting: list[str] = []
#: Actions that wait: for what, the action that lets them wait, and these.
deferred: list[tuple[list[str], Any, Iterable[Any]]] = []
environment: dict[str, str] = {}


def evaluate(request: dict[str, Any]) -> None:
    """Fill the document with what a launch file starts.

    Args:
        request: `file`: its path, or its package and name, as `ros2 launch` takes them;
            `arguments` by name; `around`: what an including file has set: `namespace`, and `env`,
            `parameters` and `remappings` by name. Their texts may have substitutions.
    """
    import launch
    from launch.actions import IncludeLaunchDescription, SetEnvironmentVariable
    from launch.launch_description_sources import AnyLaunchDescriptionSource
    from launch_ros.actions import PushRosNamespace, SetParameter, SetRemap

    around = request.get("around", {})
    actions: list[Any] = []
    if around.get("namespace"):
        actions.append(PushRosNamespace(around["namespace"]))
    actions += [SetEnvironmentVariable(k, parse(v)) for k, v in around.get("env", {}).items()]
    actions += [SetParameter(k, v) for k, v in around.get("parameters", {}).items()]
    actions += [SetRemap(k, v) for k, v in around.get("remappings", {}).items()]
    file = find_file(*request["file"]) if len(request["file"]) > 1 else parse(request["file"][0])
    arguments = [(name, parse(value)) for name, value in request["arguments"].items()]
    source = AnyLaunchDescriptionSource(file)
    actions.append(IncludeLaunchDescription(source, launch_arguments=arguments))

    argv = ["{}:={}".format(*pair) for pair in request["arguments"].items()]
    context = launch.LaunchContext(argv=argv)
    context._set_asyncio_loop(asyncio.new_event_loop())  # for futures; it never runs
    walk(launch.LaunchDescription(actions), context)
    for reasons, action, later in deferred:  # they add more
        walk_later(reasons, action, later, context)


def parse(text: str) -> Any:
    """Return the substitutions of a text, which may have their form in ROS 1."""
    from launch.frontend.parse_substitution import parse_substitution

    text = re.sub(r"\$\(optenv (\S+)\)", r"$(env \1 '')", text)
    text = text.replace("$(optenv ", "$(env ").replace("$(find ", "$(find-pkg-share ")
    return parse_substitution(text) if "$(" in text else text


def perform(context: Any, value: Any) -> str:
    """Return the text of substitutions."""
    from launch.utilities import normalize_to_list_of_substitutions, perform_substitutions

    text: str = perform_substitutions(context, normalize_to_list_of_substitutions(value))
    return text


def find_file(package: str, name: str) -> str:
    """Return the path of a launch file of a package, as `ros2 launch` finds it."""
    from ament_index_python.packages import get_package_share_directory

    share = get_package_share_directory(package)
    paths = list(Path(share).rglob(name))
    if len(paths) != 1:
        raise LookupError(f"{package} has {len(paths) or 'no'} files {name} in {share}")
    return str(paths[0])


def walk(entity: Any, context: Any) -> None:
    """Visit an action and all that it yields. An error gets the place of the innermost action."""
    try:
        for inner in entity.visit(context) or ():
            walk(inner, context)
    except Exception as error:
        error.__dict__.setdefault("place", place_of(entity, context))
        raise


# Places


def place_of(action: Any, context: Any) -> list[Any]:
    """Return the file and line that made an action; the line is 1 if only the file is known."""
    file = context.get_locals_as_dict().get("current_launch_file_path", "")
    return getattr(action, "place", None) or [file, 1]


def find_place(frame: FrameType | None) -> list[Any] | None:
    """Return the file and line of the innermost call that is not launch's own."""
    while frame is not None:
        module = frame.f_globals.get("__name__", "").partition(".")[0]
        if module not in OWN and frame.f_code.co_filename.startswith("/"):
            return [frame.f_code.co_filename, frame.f_lineno]
        frame = frame.f_back
    return None


def describe_error(error: BaseException) -> dict[str, Any]:
    """Return an error with its place in a launch file, if it has one."""
    place = getattr(error, "place", None)
    while error.__cause__ is not None and type(error).__name__ == "InvalidLaunchFileError":
        error = error.__cause__  # what made it invalid
    for frame, line in traceback.walk_tb(error.__traceback__):
        if frame.f_globals.get("__name__") == "python_launch_file":
            place = [frame.f_code.co_filename, line]
    if isinstance(error, SyntaxError) and error.filename:
        place = [error.filename, error.lineno]
    return {"message": f"{type(error).__name__}: {error}".strip(), "place": place}


# What actions do here


def replace() -> None:
    """Let actions that start, wait or send something only be noted."""
    from launch import actions, substitutions
    from launch.action import Action
    from launch.substitutions import Command, LaunchConfiguration
    from launch_ros.actions import LifecycleNode, LoadComposableNodes
    from launch_ros.substitutions import ExecutableInPackage

    def around(kind: Any, name: str, note: Callable[..., Any]) -> None:
        """Let a method be `note`, which gets the method and its arguments."""
        method = getattr(kind, name)
        setattr(kind, name, lambda *args, **keywords: note(method, *args, **keywords))

    around(Action, "__init__", note_place)
    around(actions.DeclareLaunchArgument, "execute", note_argument)
    around(LaunchConfiguration, "perform", note_use)
    around(Command, "perform", note_command)
    if hasattr(substitutions, "FileContent"):  # not in humble
        around(substitutions.FileContent, "perform", note_file)
    around(ExecutableInPackage, "perform", note_program)
    around(actions.ExecuteLocal, "execute", note_process)
    around(LifecycleNode, "execute", note_lifecycle)
    around(LoadComposableNodes, "execute", note_components)
    around(actions.TimerAction, "execute", note_timer)
    around(actions.RegisterEventHandler, "execute", note_handler)
    around(actions.EmitEvent, "execute", note_event)
    around(actions.OpaqueCoroutine, "execute", note_coroutine)


def note_place(method: Any, action: Any, **options: Any) -> None:
    """Note where an action is made."""
    action.place = find_place(sys._getframe(1))
    method(action, **options)


def note_argument(method: Any, action: Any, context: Any) -> Any:
    """Note the name of a declared argument."""
    found["arguments"].append(action.name)
    return method(action, context)


def note_use(method: Any, configuration: Any, context: Any) -> Any:
    """Note the name of an argument that is used, declared or not."""
    found["arguments"].append(perform(context, configuration.variable_name))
    return method(configuration, context)


def note_command(method: Any, command: Any, context: Any) -> Any:
    """Note the line of a program that prints a value; it does run."""
    output = method(command, context)
    found["commands"][output] = perform(context, command.command)
    return output


def note_file(method: Any, content: Any, context: Any) -> Any:
    """Note the file that is a value, as the line that prints it."""
    output = method(content, context)
    found["commands"][output] = f"cat {shlex.quote(perform(context, content.path))}"
    return output


def note_program(method: Any, program: Any, context: Any) -> str:
    """Return a word with the package and name of an executable, which may be missing here."""
    parts = (perform(context, part) for part in (program.package, program.executable))
    return MARK + MARK.join(parts) + MARK


def note_process(method: Any, action: Any, context: Any) -> None:
    """Note the command line of a process, for a node with all that launch_ros adds to it."""
    action.prepare(context)
    details = action.process_details
    files = {}
    for option, file in zip(details["cmd"], details["cmd"][1:]):
        if option == "--params-file":
            files[file] = Path(file).read_text("utf-8")  # launch_ros removes some of them later
    env = sorted((details["env"] or {}).items())
    process = {
        "command": details["cmd"],
        "env": {key: value for key, value in env if environment.get(key) != value},
        "files": files,
        "name": re.sub(r"-\d+$", "", details["name"]),
        "place": place_of(action, context),
        "shell": action.shell,
        "waiting": waiting[:],
        "lost": [],
    }
    if details["cwd"]:
        process["lost"].append("cwd")
    if getattr(action, "_ExecuteLocal__on_exit", None):
        process["lost"].append("on_exit")
    found["processes"].append(process)


def note_lifecycle(method: Any, action: Any, context: Any) -> Any:
    """Note a lifecycle node without waiting for its transitions."""
    from launch_ros.actions import Node

    result = Node.execute(action, context)
    found["processes"][-1]["lost"].append("lifecycle_node")
    return result


def note_components(method: Any, action: Any, context: Any) -> None:
    """Note what a container would be asked to load."""
    from launch_ros.actions import Node
    from launch_ros.actions.load_composable_nodes import get_composable_node_load_request

    container, place = action._LoadComposableNodes__target_container, place_of(action, context)
    if isinstance(container, Node):
        name, place = container.node_name, getattr(action, "place", None) or container.place
    else:
        name = perform(context, container)
    for description in action._LoadComposableNodes__composable_node_descriptions:
        condition = getattr(description, "condition", lambda: None)()
        if condition is not None and not condition.evaluate(context):
            continue
        request = get_composable_node_load_request(description, context)
        component = {
            "container": name,
            "extra_arguments": read_parameters(request.extra_arguments),
            "name": request.node_name,
            "namespace": request.node_namespace,
            "package": request.package_name,
            "parameters": read_parameters(request.parameters),
            "place": place,
            "plugin": request.plugin_name,
            "remappings": list(request.remap_rules),
            "waiting": waiting[:],
        }
        found["components"].append(component)


def read_parameters(messages: Iterable[Any]) -> dict[str, Any]:
    """Return parameters by name."""
    from rclpy.parameter import Parameter

    values = {one.name: Parameter.from_parameter_msg(one).value for one in messages}
    return {k: v.tolist() if hasattr(v, "tolist") else v for k, v in values.items()}


def note_timer(method: Any, action: Any, context: Any) -> None:
    """Let the actions of a timer come later."""
    deferred.append(([*waiting, "a timer"], action, action.actions))


def note_handler(method: Any, action: Any, context: Any) -> None:
    """Let the actions of an event's handler come later, if they are known before the event."""
    kind = type(action.event_handler).__name__
    actions = action.event_handler.describe()[1] if kind != "OnShutdown" else []
    deferred.append(([*waiting, f"`{kind}`"], action, actions))


def walk_later(reasons: list[str], action: Any, actions: Iterable[Any], context: Any) -> None:
    """Visit actions that wait, when the groups around them have ended, as in ROS.

    A remark says if they start nothing.
    """
    before = len(found["processes"]) + len(found["components"]) + len(deferred)
    waiting[:] = reasons
    for inner in actions:
        walk(inner, context)
    if before == len(found["processes"]) + len(found["components"]) + len(deferred):
        add_remark(action, context, f"{reasons[-1]} is not carried over")


def note_event(method: Any, action: Any, context: Any) -> None:
    """Note an event that is not sent."""
    if not waiting:
        name = type(action.event).__name__
        add_remark(action, context, f"the event `{name}` is not carried over")


def note_coroutine(method: Any, action: Any, context: Any) -> None:
    """Note a coroutine that is not run."""
    add_remark(action, context, "`OpaqueCoroutine` is not carried over")


def add_remark(action: Any, context: Any, message: str) -> None:
    """Note what is not carried over, at its place."""
    found["remarks"].append({"place": place_of(action, context), "message": message})


def main(request: dict[str, Any]) -> None:
    """Print the document."""
    output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # for the prints of launch files and their programs
    os.environ.setdefault("ROS_LOG_DIR", tempfile.mkdtemp())
    environment.update(os.environ)
    try:
        replace()
        evaluate(request)
    except Exception as error:
        traceback.print_exc()
        found["error"] = describe_error(error)
    else:
        from ament_index_python.packages import get_packages_with_prefixes

        found["arguments"] = sorted({*found["arguments"]})
        text = json.dumps(found, default=str)
        shares = (
            (f"{prefix}/share/{name}", name)
            for name, prefix in get_packages_with_prefixes().items()
        )
        found["shares"] = {share: name for share, name in shares if share in text}
        found["temporary"] = tempfile.gettempdir()
    output.write("\n".join(["", BEGIN, json.dumps(found, default=str), END, ""]))
    output.flush()


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))

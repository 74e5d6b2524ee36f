"""What is wrong with what containers run: command lines, substitution args, parameters.

Paths begin at the node or job.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Literal

import attrs

from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import ParameterOptions, file_of
from rigel_k8s.app.programs import SHELLS, split
from rigel_k8s.objects.podoptions import Readiness
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.text import split_words
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem
from rigel_k8s.substitution_args import (
    FORMS,
    find_expressions,
    has_substitution,
    is_substituted,
    is_variable,
)

#: Where substitution args are replaced.
IN_PARAMETERS = ("parameters", "parameter_files", "parameter_commands")
IN_NODES = ("args", "command", "launch", "env", "components", *IN_PARAMETERS)
#: Where an expression is probably not meant as text, and the severity if it stays text.
NOT_LITERAL: Mapping[str, Literal["error", "warning"]] = {
    "parameter_files": "error",
    "parameter_commands": "error",
    "components": "warning",
    "parameters": "warning",
    "args": "warning",
}
OPERATORS = frozenset(("&", "&&", "||", "|", ";", ">", ">>", "<", "2>&1"))
#: Commands that only a shell has.
BUILT_IN = ("source", ".", "export", "cd")


def check_line(
    path: Path, line: str | Sequence[Any], options: ParameterOptions | None = None
) -> Iterator[Problem]:
    """Yield why a command line is not valid.

    Args:
        options: those of a line in which substitution args may be replaced.
    """
    try:
        empty = not (split_words(line) if options is None else split(options, line))
    except ValueError as error:
        message = f"it cannot be split into words: {str(error).lower()}"
        yield Problem(path, message, "bad-command")
        return
    if empty:
        yield Problem(path, "the command line is empty: remove it", "bad-command")


def split_or_none(node: NodeOptions, line: str | Sequence[Any] | None) -> list[str]:
    """Return the words of a line; none if it cannot be split, which `check_line` reports."""
    try:
        return split(node, line or [])
    except ValueError:
        return []


def runs_shell(node: NodeOptions) -> bool:
    """Return whether a shell reads `args`."""
    line = split_or_none(node, node.command) or split_or_none(node, node.args)
    return bool(line) and PurePosixPath(line[0]).name in SHELLS


def check_shell_words(node: NodeOptions) -> Iterator[Problem]:
    """Yield words of `args` that only a shell would act on, and none reads them."""
    words = split_or_none(node, node.args)
    if runs_shell(node):
        return
    found = [word for word in words if word in OPERATORS]
    if node.command is None and node.package is None and words[:1] and words[0] in BUILT_IN:
        found.insert(0, words[0])
    if found:
        message = f'no shell reads args, so "{found[0]}" is a plain word: write [bash, -c, "..."]'
        yield Problem(("args",), message, "no-shell", severity="warning", at_key=True)


def check_parameters(options: ParameterOptions, ros: Generation) -> Iterator[Problem]:
    """Yield files without a path, commands without a word, and what the generation refuses."""
    yield from ros.check_parameters(options)
    for index, entry in enumerate(map(file_of, options.parameter_files)):
        if bool(entry.file) == bool(entry.image_file):
            message = "set either file, beside the Rigelfile, or image_file"
            yield Problem(("parameter_files", index), message, "bad-parameter-file")
    for name, command in options.parameter_commands.items():
        yield from check_line(("parameter_commands", str(name)), command, options)


def check_substitution(
    options: NodeOptions | OrchestrationOptions, keys: tuple[str, ...]
) -> Iterator[Problem]:
    """Yield expressions that look as if they were replaced but are not."""
    for key in keys:
        value = as_data(getattr(options, key))
        if options.substitution_args:
            unknown = (
                text
                for text in find_expressions(value)
                if not is_substituted(text) and not is_variable(text)
            )
            for text in dict.fromkeys(unknown):
                message = f"unknown substitution arg {text}: use {FORMS}"
                yield Problem((key,), message, "unknown-substitution", at_key=True)
        elif key == "args" and isinstance(options, NodeOptions) and runs_shell(options):
            continue  # $(...) is the shell's
        elif key in NOT_LITERAL and has_substitution(value):
            text = next(filter(is_substituted, find_expressions(value)))
            message = f"{text} is not replaced: set substitution_args: true"
            severity = NOT_LITERAL[key]
            yield Problem((key,), message, "no-substitution", severity=severity, at_key=True)


def as_data(value: Any) -> Any:
    """Return an option as plain data, the fields of its parts too."""
    if isinstance(value, list):
        return [as_data(item) for item in value]
    if isinstance(value, Mapping):
        return {key: as_data(item) for key, item in value.items()}
    return attrs.asdict(value) if attrs.has(type(value)) else value


#: Programs that end, unless one of these words is among theirs.
ENDING = (
    (re.compile(r"^ros2 bag play\b"), ("--loop", "-l")),
    (re.compile(r"^(rosbag play|rosrun rosbag play)\b"), ("--loop", "-l")),
    (re.compile(r"^ros2 (topic|service|action|param|node) (list|info|call|get|set|type)\b"), ()),
    (re.compile(r"^ros(topic|service|node|param) (list|info|call|get|set|type)\b"), ()),
)
#: Those that end only with one of these words.
ONCE = (
    (re.compile(r"^ros2 topic pub\b"), ("--once", "-1", "-t", "--times")),
    (re.compile(r"^rostopic pub\b"), ("--once", "-1")),
    (re.compile(r"^ros2 topic echo\b"), ("--once",)),
)
#: Executables of packages that end, by the generation.
RUN_ONCE: dict[str, tuple[tuple[str, str], ...]] = {
    "1": (("gazebo_ros", "spawn_model"), ("map_server", "map_saver")),
    "2": (
        ("controller_manager", "spawner"),
        ("controller_manager", "unspawner"),
        ("gazebo_ros", "spawn_entity.py"),
        ("nav2_map_server", "map_saver_cli"),
        ("ros_gz_sim", "create"),
    ),
    "none": (),
}
ONCE_ONLY = "run it once (kind: task)"
#: Programs that only wait, and what a shell without a command does.
WAITING = ("sleep", "tail")
#: Programs of ROS that only a shell with ROS finds, and what sets ROS up.
TOOLS = re.compile(r"\b(ros2|rosnode|rostopic|rosservice|rosparam|rosrun|rospack)\b")
SET_UP = re.compile(rf"\bsetup\.(ba|z)?sh\b|ros_entrypoint|{SCRIPTS_PATH}/exec\.sh")


def check_program(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what a program does differently in a pod."""
    yield from check_probe(node)
    line = ros.find_program(node)
    path = ("command" if node.command is not None else "args",)
    if not line or node.launch or node.kind:
        return
    if node.package:
        if (node.package, str(node.executable)) in RUN_ONCE[ros.name]:
            message = (
                f"{node.executable} ends, and Kubernetes starts it again each time: {ONCE_ONLY}"
            )
            yield Problem(("executable",), message, "ends", severity="warning", at_key=True)
        return
    if len(line) == 1 and " " in line[0].strip() and not has_template(line[0]):
        message = f'"{line[0]}" is one word, the name of a program: write it as a text, or a list'
        yield Problem(path, message, "one-word", severity="warning", at_key=True)
    elif node.components and line[0].startswith("-"):
        message = f'"{line[0]}" would be the program that loads components: add its package first'
        yield Problem(path, message, "bad-command", at_key=True)
    elif node.ros is None and (reason := explain_end(line)):
        yield Problem(path, reason, "ends", severity="warning", at_key=True)


def explain_end(line: Sequence[str]) -> str | None:
    """Return what happens to a pod whose program ends, or is no node; None if it may be one."""
    name = PurePosixPath(line[0]).name
    text = " ".join([name, *line[1:]])
    ends = any(rule.search(text) and not set(words) & set(line) for rule, words in ENDING)
    if ends or any(rule.search(text) and set(words) & set(line) for rule, words in ONCE):
        program = " ".join([name, *line[1:3]])
        again = f"{program} ends, and Kubernetes starts it again each time: {ONCE_ONLY}"
        return f"{again}, or let it go on (--loop)" if ends and "play" in text else again
    waits = name in WAITING and line[1:] and (name == "sleep" or "/dev/null" in line)
    if waits or (name in SHELLS and len(line) == 1):
        return f"{text} is no ROS node, so its pod never becomes ready: set `ros: none`"
    return None


def check_probe(node: NodeOptions) -> Iterator[Problem]:
    """Yield a probe that does not find ROS: it runs without the image's ENTRYPOINT."""
    command = node.readiness.command if isinstance(node.readiness, Readiness) else None
    try:
        text = " ".join(split_words(command or []))
    except ValueError:  # reported elsewhere
        return
    found = TOOLS.search(text)
    if found and not SET_UP.search(text):
        message = (
            f"a probe runs without the image's ENTRYPOINT, so it does not find {found[1]}: write"
            f" [/bin/sh, {SCRIPTS_PATH}/exec.sh, ...], or leave `readiness` out"
        )
        path = ("readiness", "command")
        yield Problem(path, message, "probe", severity="warning", at_key=True)

"""What is wrong with what containers run: command lines, substitution args, parameters.

Paths begin at the node or job.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, Literal

import attrs

from rigel_k8s.app.environment import entries
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import ParameterOptions, file_of
from rigel_k8s.app.programs import SHELLS, split
from rigel_k8s.objects.overlay import containers_of, find_below
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.text import split_words
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem, Severity
from rigel_k8s.ros import ROS_ARGS, ROS_ARGS_END
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
#: Commands that only a shell has, and its variables.
BUILT_IN = re.compile(r"(source|\.|export|cd)$|[A-Z_][A-Z0-9_]*=")
#: What a shell, or docker compose, fills in; ${node} is one of ROSCONSOLE_FORMAT.
VARIABLE, COMPOSED = re.compile(r"\$\{?[A-Za-z_]"), re.compile(r"\$\{[A-Z_][A-Z0-9_]*[}:?+-]")


def check_line(
    path: Path, line: str | Sequence[Any], options: ParameterOptions | None = None
) -> Iterator[Problem]:
    """Yield why a command line is not valid, or is one for a shell.

    Args:
        options: those of a line in which substitution args may be replaced.
    """
    try:
        words = split_words(line) if options is None else split(options, line)
    except ValueError as error:
        message = f"it cannot be split into words: {str(error).lower()}"
        yield Problem(path, message, "bad-command")
        return
    if not words:
        yield Problem(path, "the command line is empty: remove it", "bad-command")
    elif PurePosixPath(words[0]).name not in SHELLS and (marks := OPERATORS.intersection(words)):
        first = next(word for word in words if word in marks)
        message = f'no shell reads it, so "{first}" is a plain word: write [bash, -c, "..."]'
        yield Problem(path, message, "no-shell", severity="warning", at_key=True)


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
    if runs_shell(node) or OPERATORS.intersection(words):
        return
    found = [word for word in words if VARIABLE.search(word)]
    if node.command is None and node.package is None and BUILT_IN.match("".join(words[:1])):
        found.insert(0, words[0])
    if found:
        message = f'no shell reads it, so "{found[0]}" is a plain word: write [bash, -c, "..."]'
        yield Problem(("args",), message, "no-shell", severity="warning", at_key=True)


def check_variables(node: NodeOptions) -> Iterator[Problem]:
    """Yield variables with a text that docker compose would fill in."""
    for index, (name, source) in enumerate(entries(node.env)):
        value = str(source.get("value", ""))
        if COMPOSED.search(value):
            message = (
                f'"{value}" stays as it is: write {{{{ vars.NAME }}}}, or $(NAME) for another'
                " variable of the container"
            )
            place = name if isinstance(node.env, Mapping) else index
            yield Problem(("env", place), message, "no-substitution", severity="warning")


def check_parameter_options(options: ParameterOptions, ros: Generation) -> Iterator[Problem]:
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
    (re.compile(r"^(ros2 bag|rosbag|rosrun rosbag) play\b"), ("--loop", "-l")),
    (
        re.compile(
            r"^ros(2 (topic|service|action|param|node|lifecycle|component|control|bag)"
            r"|topic|service|node|param|bag)"
            r" (call|cleanup|delete|dump|get|info|list|load|send_goal|set|type|unload)(_\w+)?\b"
        ),
        (),
    ),
    (
        re.compile(
            r"^(ros2 run (controller_manager (un)?spawner(\.py)?|gazebo_ros spawn_entity\.py"
            r"|nav2_map_server map_saver_cli|ros_gz_sim create|rosbag2_transport player)"
            r"|rosrun (gazebo_ros spawn_model|map_server map_saver))\b"
        ),
        (),
    ),
)
#: Those that end only with one of these words.
ONCE = (
    (re.compile(r"^ros2 topic pub\b"), ("--once", "-1", "-t", "--times")),
    (re.compile(r"^rostopic pub\b"), ("--once", "-1")),
    (re.compile(r"^ros2 topic echo\b"), ("--once",)),
)
ONCE_ONLY = "run it once (kind: task)"
#: Programs that only wait, and what a shell without a command does.
WAITING = ("sleep", "tail")
#: Servers of a network's mode.
SERVERS = {
    re.compile(r"^fast-?dds discovery\b"): "discovery-server",
    re.compile(r"\brmw_zenohd\b"): "zenoh",
}
#: What is before a program, and becomes it.
BEFORE = re.compile(r"exec|env|--|/ros_entrypoint\.sh|[A-Za-z_]\w*=.*", re.S)
#: Something runs beside what a shell waits for.
BESIDE = re.compile(r"(?<![&>])&(?!&)")
#: An option with its value in one word, as no program reads it.
JOINED = re.compile(r"--?[A-Za-z][\w-]* \S.*", re.S)
#: Programs of ROS that only a shell with ROS finds, and what sets ROS up.
TOOLS = re.compile(
    r"\b(ros2|ros(bag|core|graph|launch|msg|node|pack|param|run|service|topic)|rclpy|rospy)\b"
)
SET_UP = re.compile(rf"\bsetup\.(ba|z)?sh\b|ros_entrypoint|{SCRIPTS_PATH}/exec\.sh")
#: Where Kubernetes has commands of its own.
HOOKS = (
    *(("readinessProbe",), ("livenessProbe",), ("startupProbe",)),
    *(("lifecycle", "postStart"), ("lifecycle", "preStop")),
)
#: Options of rcl with a value: parameters, remappings, and others; and those without.
PARAMETERS, REMAPPINGS = ("-p", "--param"), ("-r", "--remap")
OTHERS = (
    *("--params-file", "--log-level", "--log-config-file", "--log-file-name"),
    *("-e", "--enclave"),
)
SWITCHES = re.compile(r"--(en|dis)able-(rosout|stdout|external-lib)-logs")
#: A parameter, or a remapping of a private name. ROS 2 reads other remappings without a flag, too.
ROS1_FORM = re.compile(r"(_[A-Za-z]|~(?!/))\w*:=")
LAUNCH_FILE = re.compile(r"\.launch(\.\w+)?$")


def check_program(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what a program does differently in a pod."""
    yield from check_words(node)
    yield from check_ros_arguments(node, ros)
    yield from check_variables(node)
    line = ros.find_program(node)
    path = ("executable",) if node.package else line_path(node)
    if node.command is not None and ros.nodes and TOOLS.match(" ".join(find_last(line))):
        yield from check_tools(("command",), line, "replaces", "write `args` instead")
    for index, one in enumerate(containers_of(node.patch)):
        for above in HOOKS:
            where = (*above, "exec", "command")
            command = find_below(one, where)
            place = ("patch", "spec", "template", "spec", "containers", index, *where)
            yield from check_probe(place, command if isinstance(command, list) else None)
    if not line or node.launch or node.kind:
        return
    if node.components and line[0].startswith("-"):
        message = f'"{line[0]}" would be the program that loads components: add its package first'
        yield Problem(path, message, "bad-command", at_key=True)
    elif node.ros is None and (reason := explain_end(line)):
        yield Problem(path, reason, "ends", severity="warning", at_key=True)


def line_path(node: NodeOptions) -> tuple[str]:
    """Return the option with a node's command line."""
    return ("command",) if node.command is not None else ("args",)


def check_words(node: NodeOptions) -> Iterator[Problem]:
    """Yield words that are several, and a launch file as a program."""
    line = split_or_none(node, node.command) or split_or_none(node, node.args)
    program = None if node.package or not line else line[0]
    named: dict[Path, str | None] = {
        ("package",): node.package,
        ("executable",): node.executable,
        ("launch", "file"): node.launch.file if node.launch else None,
        line_path(node): program,
    }
    for path, word in named.items():
        if word and " " in word.strip() and not is_filled_in(word):
            message = (
                f'"{word}" is one word, the name of a program or file: write a text, or a list'
            )
            yield Problem(path, message, "one-word", severity="warning", at_key=True)
    if node.executable and LAUNCH_FILE.search(node.executable):
        message = f"a launch file is no program: write `launch: {{file: {node.executable}, ...}}`"
        yield Problem(("executable",), message, "bad-command", at_key=True)
    if joined := next(filter(JOINED.fullmatch, line[bool(program) :]), None):
        message = f'"{joined}" is one word, which a program does not take apart: write two'
        severity: Severity = "error" if ROS_ARGS in line[: line.index(joined)] else "warning"
        yield Problem(line_path(node), message, "one-word", severity=severity, at_key=True)
    text = find_text(line if program else ())
    if text[1:] and not set(" $") & set(text[0]):
        message = f'the shell runs "{text[0]}" without the words behind it: put the line in quotes'
        yield Problem(line_path(node), message, "one-word", severity="warning", at_key=True)


def check_ros_arguments(node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield arguments with which rcl ends a node, and those of ROS 1, which it does not read."""
    line, reads, option = ros.find_program(node), False, ""
    if not ros.rmw or node.launch or not ros.takes_arguments(line) or "xacro" in line:
        return
    for word in (one for one in line if not JOINED.fullmatch(one)):
        fault: str | None = None
        severity: Severity = "error"
        if option:
            fault, option = explain_option_value(ros, option, word), ""
        elif word in (ROS_ARGS, ROS_ARGS_END):
            reads = word == ROS_ARGS
        elif reads and word in (*PARAMETERS, *REMAPPINGS, *OTHERS):
            option = word
        elif reads and not SWITCHES.fullmatch(word) and not is_filled_in(word):
            fault = (
                f'ROS 2 does not know "{word}" behind {ROS_ARGS}: write -p or -r before it, or --'
            )
        elif not reads and ROS1_FORM.match(word):
            instead = f"{ROS_ARGS} -p NAME:=VALUE, or -r ~/NAME:=TOPIC"
            fault, severity = f'"{word}" is the form of ROS 1: write {instead}', "warning"
        if fault:  # it may have changed the meaning of the others
            yield Problem(line_path(node), fault, "ros-args", severity=severity, at_key=True)
            return
    if option:
        fault = f"{option} has no value"
        yield Problem(line_path(node), fault, "ros-args", at_key=True)


def explain_option_value(ros: Generation, option: str, value: str) -> str | None:
    """Return why rcl refuses the value of an option, None if it accepts it."""
    left, _, right = value.partition(":=")
    if option in OTHERS or is_filled_in(value):
        return None
    if not left or not right:
        return f'"{value}" behind {option} is not NAME:=VALUE'
    if option in PARAMETERS or ros.names is None or left.rpartition(":")[2].startswith("__"):
        return None
    return ros.names.explain(ros.names.source, left) or ros.names.explain(ros.names.target, right)


def is_filled_in(word: str) -> bool:
    """Whether a part of a word is known only when it runs: a template, or $(find PACKAGE)."""
    return has_template(word) or "$(" in word


def find_text(line: Sequence[str]) -> Sequence[str]:
    """Return what a shell runs, and the words behind that; nothing for another program."""
    if line and PurePosixPath(line[0]).name in SHELLS:
        for index, word in enumerate(line[1:], 2):
            if re.fullmatch(r"-[a-z]*c", word):
                return line[index:]
            if not word.startswith("-") and word != "pipefail":
                break
    return ()


def find_last(line: Sequence[str]) -> list[str]:
    """Return the program that a line becomes: of a shell's text, the last one."""
    words = list(line)
    while words and BEFORE.fullmatch(words[0]):
        del words[0]
    if not (text := find_text(words)):
        return words
    try:
        parts = [part for part in re.split(r"[;&|\n]+", text[0]) if part.strip()]
        return find_last(split_words(parts[-1])) if parts else []
    except ValueError:  # a mark is within quotes
        return []


def explain_end(line: Sequence[str]) -> str | None:
    """Return what happens to a pod whose program ends, or is no node; None if it may be one."""
    words = find_last(line)
    name = PurePosixPath(words[0]).name if words else ""
    text = " ".join([name, *words[1:]])
    ends = [rule.search(text) for rule, own in ENDING if not set(own) & set(words)]
    ends += [rule.search(text) for rule, own in ONCE if set(own) & set(words)]
    if found := next(filter(None, ends), None):
        again = f"{found[0]} ends, and Kubernetes starts it again each time: {ONCE_ONLY}"
        return f"{again}, or let it go on (--loop)" if found[0].endswith("play") else again
    for rule, mode in SERVERS.items():
        if found := rule.search(text):
            never = f"{found[0]} is no ROS node, so its pod never becomes ready"
            return f"{never}: `network: {mode}` has one; or set `ros: none`"
    waits = name in WAITING and words[1:] and (name == "sleep" or "/dev/null" in words)
    waits = waits and not BESIDE.search(" ".join(line))
    if waits or (name in SHELLS and len(words) == 1):
        return f"{text} is no ROS node, so its pod never becomes ready: set `ros: none`"
    return None


def check_probe(path: Path, command: str | Sequence[Any] | None) -> Iterator[Problem]:
    """Yield a command of Kubernetes that is one of docker compose, or does not find ROS."""
    try:
        words = split_words(command or [])
    except ValueError:  # reported elsewhere
        return
    if words[:1] in (["CMD"], ["CMD-SHELL"]):
        message = f'"{words[0]}" is for docker compose only: write what is behind it'
        yield Problem(path, message, "bad-command", at_key=True)
    else:
        instead = f"write [/bin/sh, {SCRIPTS_PATH}/exec.sh, ...], or leave it out"
        yield from check_tools(path, words, "runs without", instead)


def check_tools(path: Path, words: Sequence[str], does: str, instead: str) -> Iterator[Problem]:
    """Yield that a command does not find a program of ROS, which only the ENTRYPOINT sets up."""
    text = " ".join(words)
    found = TOOLS.search(text)
    if found and not SET_UP.search(text):
        message = f"it {does} the image's ENTRYPOINT, so it does not find {found[1]}: {instead}"
        yield Problem(path, message, "probe", severity="warning", at_key=True)

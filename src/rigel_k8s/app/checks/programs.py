"""Programs that end, take no part in ROS, or are not found; paths are the node's own.

Each is a habit of the command line or of docker compose that a pod does not have.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import SHELLS
from rigel_k8s.objects.podoptions import Readiness
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.text import split_words
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem

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

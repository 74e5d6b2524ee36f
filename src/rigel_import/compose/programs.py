"""What a service runs: its command line as options of a node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rigel_import.compose.service import Service
from rigel_k8s.ros import ROS_ARGS

#: Options of roslaunch and ros2 launch that change nothing in a pod.
QUIET = ("--wait", "--screen", "--noninteractive", "-n")
#: Rules of arguments that are options of a node.
NAMES = {"__node": "name", "__name": "name", "__ns": "namespace"}
UNNAMED = (
    "the ROS name is not in the Compose file: if it is always the same, set `name` to it and remove"
    " `anonymous` and `update`, so that updates hand over"
)


def add_program(service: Service) -> None:
    """Add the options of what a service runs."""
    if service.ros is None:
        service.options["ros"] = "none"
    program = read_program(service)
    service.options |= program
    if service.ros and not {"name", "launch"} & program.keys():
        service.options |= {"anonymous": True, "update": {"strategy": "Recreate"}}
        service.remark(service.content, UNNAMED)


def read_program(service: Service) -> dict[str, Any]:
    """Return the options of what a service runs."""
    words = [word.written for word in service.content.get("command").words()]
    if entrypoint := service.content.get("entrypoint").words():
        return {"command": [*(word.written for word in entrypoint), *words]}
    match words:
        case ["ros2", "launch", *rest] | ["roslaunch", *rest]:
            if launch := read_launch(rest):
                return {"launch": launch}
        case ["ros2", "run", package, executable, *rest] | ["rosrun", package, executable, *rest]:
            return {"package": package, "executable": executable, **read_arguments(rest)}
    return {"args": words} if words else {}


def read_launch(words: Sequence[str]) -> dict[str, Any] | None:
    """Return the option `launch` for a package, a file and arguments; None if there is more."""
    names = [word for word in words if ":=" not in word and word not in QUIET]
    args = dict(word.partition(":=")[::2] for word in words if ":=" in word)
    if len(names) not in (1, 2) or any(name.startswith("-") for name in names):
        return None
    launch: dict[str, Any] = {"package": names[0]} if len(names) == 2 else {}
    launch["file"] = names[-1]
    return {**launch, "args": args} if args else launch


def read_arguments(words: Sequence[str]) -> dict[str, Any]:
    """Return a node's name, namespace, and its other arguments."""
    options: dict[str, Any] = {}
    args: list[str] = []
    for word in words:
        name, _, value = word.partition(":=")
        if name in NAMES:
            options[NAMES[name]] = value
            args = args[:-1] if args[-1:] in (["-r"], ["--remap"]) else args
        else:
            args.append(word)
    args = args[:-1] if args[-1:] == [ROS_ARGS] else args
    return {"args": args, **options} if args else options

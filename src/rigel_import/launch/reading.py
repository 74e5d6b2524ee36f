"""The entry: a launch file as a draft, with the tags of the generation of ROS that it is for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rigel_import.draft import Draft, Place, Remark
from rigel_import.launch import ros1, ros2
from rigel_import.launch.actions import follow
from rigel_import.launch.packages import find_package, find_packages, find_workspace
from rigel_import.launch.scope import Robot, Scope
from rigel_import.text import read_text
from rigel_k8s.distros import CURRENT
from rigel_k8s.distros import DISTROS as SUPPORTED
from rigel_k8s.errors import UserError
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.substitution_args import has_substitution

#: By the generation of ROS.
TAGS = {"1": ros1.TAGS, "2": ros2.TAGS}
DISTROS = {"1": "noetic", "2": CURRENT}
OPTIONS = {"1": {}, "2": {"network": "peers"}}  # the network that works on each cluster
#: What only launch files of ROS 1 contain.
OF_ROS1 = re.compile(r"<node\s[^>]*\btype\s*=|<rosparam\b|\$\((arg|find|optenv) ")
#: An expression that names a package.
FIND = re.compile(r"\$\(find(?:-pkg-share|-pkg-prefix)? ([\w-]+)\)")
#: The jobs that build an image.
BUILD = "jobs of rigel_k8s.DockerfilePlugin and rigel_k8s.BuildXPlugin"
#: Options in which a container replaces expressions.
SUBSTITUTED = ("args", "launch", "env", "parameters", "parameter_files", "parameter_commands")


def read(
    file: Path,
    arguments: Mapping[str, str],
    packages: Mapping[str, Path],
    image: str | None = None,
    distro: str | None = None,
) -> Draft:
    """Return a launch file as a draft.

    Args:
        arguments: the values of the launch file's arguments.
        packages: directories of packages that are not in its workspace, or win over those there.
        image: the image of all nodes.
        distro: the ROS distribution; None: the current one of the file's generation.

    Raises:
        UserError: it cannot be read, has a mistake, starts no node, or is not for that ROS.
    """
    if file.suffix == ".py":
        raise _refuse_python(file)
    ros = "1" if OF_ROS1.search(read_text(file)) else "2"
    if distro is not None and distro not in SUPPORTED[ros]:
        raise UserError(
            f"{file} is a launch file of ROS {ros}, and {distro} is not",
            hint=f"pass one of {', '.join(SUPPORTED[ros])}, or leave --distro out",
        )
    robot = Robot(ros, TAGS[ros], {**find_packages(find_workspace(file)), **packages})
    follow(Scope(robot, dict(arguments), robot.remarks), file)
    for name in sorted(arguments.keys() - robot.declared):
        message = f'{file}: no argument "{name}"{suggest(name, robot.declared)}'
        raise UserError(message, hint="correct --arg, or leave it out")
    if not robot.nodes:
        message = f"{file}: no node is started with these arguments"
        reasons = [f"{remark.place}: {remark.message}" for remark in robot.remarks]
        hint = "pass others with --arg NAME=VALUE, or choose another file"
        raise UserError(message, hint=hint, details=reasons)
    return make_draft(robot, file, image, distro)


def make_draft(robot: Robot, file: Path, image: str | None, distro: str | None) -> Draft:
    """Return what a file describes as a draft. Without an image it is that of ROS."""
    chosen, remarks = distro or DISTROS[robot.ros], robot.remarks
    if distro is None and robot.ros == "2":
        message = f"nothing names a ROS distribution: pass --distro if it is not {chosen}"
        remarks = [*remarks, Remark(Place(str(file), 1), message)]
    if needed := describe_packages(robot, chosen):
        remarks = [Remark(Place(str(file), 1), needed), *remarks]
    if image is None:
        image = f"ros:{chosen}"
        message = f"{image} does not have these packages: pass --image, or set `image`"
        remarks = [*remarks, Remark(Place(str(file), 1), message)]
    package = find_package(file)
    return Draft(
        package[0] if package else file.name.partition(".")[0],
        chosen,
        {key: finish(options) for key, options in robot.nodes.items()},
        {"image": image, **OPTIONS[robot.ros], **finish(robot.options)},
        remarks=tuple(dict.fromkeys(remarks)),
    )


def describe_packages(robot: Robot, distro: str) -> str:
    """Return which packages of the workspace the image must have, and how; "" if none."""
    used = sorted(robot.packages.keys() & {*list_packages([robot.nodes, robot.options])})
    count = "package" if len(used) == 1 else "packages"
    way = f"build one from this workspace with {BUILD}"
    if robot.ros == "1":
        way += f", or mount a folder of scripts at /opt/ros/{distro}/share/PACKAGE with `files`"
    return f"the image must have the {count} {', '.join(used)}: {way}" if used else ""


def list_packages(value: Any) -> Iterator[str]:
    """Yield the packages that options name."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from [str(item)] if key == "package" else list_packages(item)
    elif isinstance(value, list):
        for item in value:
            yield from list_packages(item)
    elif isinstance(value, str):
        yield from FIND.findall(value)


def finish(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options without those that change nothing, with `substitution_args` if needed."""
    found = dict(options)
    if "remappings" in found:
        found["remappings"] = {old: new for old, new in found["remappings"].items() if old != new}
    found = {key: value for key, value in found.items() if value not in ({}, [], "")}
    places = [found.get(key) for key in SUBSTITUTED]
    places += [part.get("parameters") for part in found.get("components", {}).values()]
    return found | ({"substitution_args": True} if has_substitution(places) else {})


def _refuse_python(file: Path) -> UserError:
    """Return the error for a launch file in Python, with what to write instead."""
    package, _ = find_package(file) or ("PACKAGE", file.parent)
    node = f"{{ launch: {{ package: {package}, file: {file.name} }} }}"
    message = f"{file}: a launch file in Python is a program, which is not run here"
    return UserError(message, hint=f"start it with a node {node}, or write it in XML or YAML")

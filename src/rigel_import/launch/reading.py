"""The entry: a launch file as a draft, with the tags of the generation of ROS that it is for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_import.draft import Draft, Place, Remark
from rigel_import.launch import ros1, ros2
from rigel_import.launch.actions import follow
from rigel_import.launch.packages import (
    find_launch_file,
    find_package,
    find_packages,
    find_workspace,
)
from rigel_import.launch.python import take_python
from rigel_import.launch.scope import Robot, Scope
from rigel_import.text import read_text
from rigel_k8s.errors import UserError
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.ros import CURRENT
from rigel_k8s.ros import DISTROS as SUPPORTED
from rigel_k8s.substitution_args import has_substitution

#: By the generation of ROS.
TAGS = {"1": ros1.TAGS, "2": ros2.TAGS}
DISTROS = {"1": "noetic", "2": CURRENT}
OPTIONS = {"1": {}, "2": {"network": "peers"}}  # the network that works on each cluster
#: What only launch files of ROS 1 contain.
OF_ROS1 = re.compile(r"<node\s[^>]*\btype\s*=|<rosparam\b|\$\((arg|find|optenv) ")
#: An expression that names a package.
FIND = re.compile(r"\$\(find(?:-pkg-share|-pkg-prefix)? ([\w-]+)\)")
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
        return read_python([str(file)], arguments, packages, image, distro)
    text = read_text(file)
    unclear = not re.search(r"\bexec\s*=|find-pkg-share|^launch:|\$\(var ", text, re.MULTILINE)
    ros = "1" if OF_ROS1.search(text) or (unclear and distro in SUPPORTED["1"]) else "2"
    if distro is not None and distro not in SUPPORTED[ros]:
        raise UserError(
            f"{file} is a launch file of ROS {ros}, and {distro} is not",
            hint=f"pass one of {', '.join(SUPPORTED[ros])}, or leave --distro out",
        )
    robot = make_robot(ros, file, packages, image)
    follow(Scope(robot, dict(arguments), robot.remarks), file)
    return finish_reading(robot, file, arguments, image, distro)


def read_python(
    words: Sequence[str],
    arguments: Mapping[str, str],
    packages: Mapping[str, Path],
    image: str | None,
    distro: str | None = None,
) -> Draft:
    """Return a launch file in Python as a draft; arguments and errors are those of `read`.

    Args:
        words: its path, or its package and name; a package that is not here is the image's.
    """
    package, name = words[0], words[-1]
    file = Path(name)
    if len(words) == 1 or package in {**find_packages(Path.cwd()), **packages}:
        file = find_launch_file(package, name, packages) if len(words) > 1 else file
        read_text(file)
        words = [str(file.resolve())]
    if image is None:
        found, _ = find_package(file) or ("PACKAGE", file.parent)
        node = f"{{ launch: {{ package: {found}, file: {file.name} }} }}"
        message = f"{file}: a launch file in Python is a program, which is only run in your image"
        raise UserError(message, hint=f"pass --image, or start it in one pod with a node {node}")
    robot = make_robot("2", file, packages, image)
    take_python(Scope(robot, dict(arguments), robot.remarks), words, image)
    draft = finish_reading(robot, file, arguments, image, distro)
    return attrs.evolve(draft, name=package) if len(words) > 1 else draft


def make_robot(ros: str, file: Path, packages: Mapping[str, Path], image: str | None) -> Robot:
    """Return a robot without nodes, with the packages of a file's workspace."""
    robot = Robot(ros, TAGS[ros], {**find_packages(find_workspace(file)), **packages})
    if image is not None:
        robot.take_python = lambda scope, words: take_python(scope, words, image)
    return robot


def finish_reading(
    robot: Robot,
    file: Path,
    arguments: Mapping[str, str],
    image: str | None,
    distro: str | None,
) -> Draft:
    """Return a robot as a draft; without an image it has that of ROS.

    Raises UserError for unknown arguments, or without nodes.
    """
    for name in sorted(arguments.keys() - robot.declared):
        message = f'{file}: no argument "{name}"{suggest(name, robot.declared)}'
        raise UserError(message, hint="correct --arg, or leave it out")
    if not robot.nodes:
        message = f"{file}: no node is started with these arguments"
        reasons = [f"{remark.place}: {remark.message}" for remark in robot.remarks]
        hint = "pass others with --arg NAME=VALUE, or choose another file"
        raise UserError(message, hint=hint, details=reasons)
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
        files=robot.texts,
    )


def describe_packages(robot: Robot, distro: str) -> str:
    """Return which packages of the workspace the image must have, and how; "" if none."""
    used = sorted(robot.packages.keys() & {*list_packages([robot.nodes, robot.options])})
    count = "package" if len(used) == 1 else "packages"
    way = "build one from this workspace with jobs of rigel_k8s.DockerfilePlugin and"
    way += " rigel_k8s.BuildXPlugin"
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

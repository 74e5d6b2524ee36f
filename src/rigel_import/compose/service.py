"""A service of a Compose file with its environment and its ROS, and the node that it becomes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from rigel_import.compose.values import Value, Variables, read_env_file
from rigel_import.draft import Place, Remark
from rigel_import.text import read_text
from rigel_k8s.ros import DISTROS

ALL_DISTROS = {name: ros for ros, names in DISTROS.items() for name in names}
#: Programs by which a command line shows its ROS.
PROGRAMS = {
    "2": re.compile(r"(?<![\w-])ros2(?![\w-])"),
    "1": re.compile(r"(?<![\w-])(roscore|roslaunch|rosrun|rosbag|rostopic|rosparam)(?![\w-])"),
}
#: Variables by which ROS 1 finds its master and other machines.
OF_ROS1 = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME")


@attrs.define
class Service:
    """A service of a Compose file, and the node that it becomes.

    Attributes:
        key: the key in `nodes`.
        directory: that of the Rigelfile, where the paths in it begin.
        content: the service's keys.
        environment: its variables with those of its env_files; without content, a variable has
            the value that it has where docker compose runs.
        distro: the ROS distribution that it names.
        ros: its generation of ROS, "1" or "2"; None without ROS.
        options: the node's.
        remarks: about the node.
        folders: the local folders that it mounts, by their paths in the Rigelfile.
        named_ports: the ports at which other services name it: 5432 in `db:5432`.
    """

    name: str
    key: str
    content: Value
    directory: Path
    environment: dict[str, Value] = attrs.field(factory=dict)
    distro: str | None = None
    ros: str | None = None
    options: dict[str, Any] = attrs.field(factory=dict)
    remarks: list[Remark] = attrs.field(factory=list)
    folders: dict[str, Place] = attrs.field(factory=dict)
    named_ports: list[Value] = attrs.field(factory=list)

    def append(self, key: str, value: Any) -> None:
        """Append to a list of the node's options what is not in there."""
        values = self.options.setdefault(key, [])
        if value not in values:
            values.append(value)

    def remark(self, value: Value, message: str) -> None:
        """Remark something about the node."""
        self.remarks.append(Remark(value.place, message, self.key))

    @property
    def line(self) -> str:
        """What it runs, as one text; "" if that is the image's."""
        words = [*self.content.get("entrypoint").words(), *self.content.get("command").words()]
        return " ".join(word.text for word in words)

    @property
    def is_on_host(self) -> bool:
        """Whether it uses the machine's network."""
        return self.content.get("network_mode").text == "host"

    @property
    def replaced(self) -> str:
        """What a release has in the place of a service that runs this, and nothing else; or ""."""
        if "roslaunch" not in self.line and re.search(r"\bros(core|master)\b", self.line):
            return "a roscore of its own, called ros-master"
        return "a router of its own with `network: zenoh`" if "rmw_zenohd" in self.line else ""


def read_services(
    contents: Mapping[str, Value], variables: Variables, directory: Path
) -> list[Service]:
    """Return services with what is known before their keys are translated."""
    services: dict[str, Service] = {}
    for name, content in contents.items():
        key = re.sub(r"\W", "_", name)
        while key in services:  # of "a-b", if this is "a_b"
            key += "_2"
        service = services[key] = Service(name, key, content, directory)
        read_environment(service, variables)
        service.distro = find_distro(service)
        service.ros = find_ros(service)
    values = [one.text for service in services.values() for one in service.environment.values()]
    text = " ".join([*values, *(service.line for service in services.values())])
    for service in services.values():
        ports = re.findall(rf"(?<![\w.-]){re.escape(service.name)}:([1-9]\d{{0,4}})\b", text)
        service.named_ports = [Value(service.content.place, port, port) for port in ports]
    return list(services.values())


def read_environment(service: Service, variables: Variables) -> None:
    for item in service.content.get("env_file").elements():
        file = item.get("path") if item.entries() else item
        if not file.path().is_file():
            service.remark(file, f"{file.path()} does not exist here: write its variables as `env`")
            continue
        service.environment |= dict(read_env_file(file.path(), variables))
    for name, value in service.content.get("environment").pairs().items():
        if value.content is None and name in variables.given:
            value = variables.fill(f"${{{name}}}", value.place)
        service.environment[name] = value


def find_distro(service: Service) -> str | None:
    """Return the ROS distribution that a service names; what builds the image comes first."""
    build = service.content.get("build")
    texts = [value.text for value in build.get("args").pairs().values()]
    dockerfile = Path(*locate_build(build))
    if build.content is not None and dockerfile.is_file():
        texts += re.findall(r"(?mi)^(?:FROM|ARG)\s+(.*)$", read_text(dockerfile))
    texts += [service.content.get("image").text, *re.findall(r"/opt/ros/(\w+)", service.line)]
    words = split_words(" ".join(texts))
    return next((word for word in words if word in ALL_DISTROS), None)


def locate_build(build: Value) -> tuple[str, str]:
    """Return the context of a build, and its Dockerfile's path in there."""
    context = build.get("context") if build.entries() else build
    return str(context.path()), build.get("dockerfile").text or "Dockerfile"


def find_ros(service: Service) -> str | None:
    """Return a service's generation of ROS: that of its program, else of its distribution."""
    for ros, programs in PROGRAMS.items():
        if programs.search(service.line):
            return ros
    if service.distro:
        return ALL_DISTROS[service.distro]
    own = service.content.get("environment").pairs()  # an env_file is often shared by all
    if any(name in own for name in OF_ROS1):
        return "1"
    has_variables = any(name.startswith(("ROS_", "RMW_")) for name in own)
    return "2" if has_variables or "ros" in split_words(service.content.get("image").text) else None


def split_words(text: str) -> list[str]:
    """Return the words of an image's name: "ros" and "jazzy" of "ros:jazzy"."""
    return re.split(r"[^a-z0-9]+", text.lower())

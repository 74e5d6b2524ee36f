"""The option `foxglove` of a job: one more node, the bridge to which Foxglove and others connect.

It is an ordinary node. Its package and its parameters are those of foxglove_bridge's documentation.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from typing import Any

import attrs

from rigel_k8s.app.addednode import show_all_topics, take_out
from rigel_k8s.objects.fields import option
from rigel_k8s.objects.marks import IMAGE_ANNOTATION
from rigel_k8s.objects.scalars import ImageRef, Port, PortName
from rigel_k8s.rigelfile.expansion import Expanded, Extension, Surroundings
from rigel_k8s.rigelfile.source import YamlNode

#: The option, the node that it stands for, and the name of its port, by which it is recognized.
KEY = "foxglove"
PORT_NAME = PortName(KEY)
#: The same in ROS 1 and ROS 2.
PACKAGE = "foxglove_bridge"


@attrs.frozen(kw_only=True)
class Foxglove:
    """The bridge to Foxglove."""

    image: ImageRef | None = option(
        "an image with foxglove_bridge and the types of all messages (default: the job's `image`)"
    )
    port: Port = option("where it listens", Port(8765))
    topics: list[str] = option(
        "regular expressions that match the whole names of the topics to show (default: all)", []
    )


def expand(node: YamlNode, _: Surroundings) -> Expanded:
    """Return a job's options with the bridge among `nodes`."""
    taken = take_out(node, KEY, Foxglove)
    described = describe(taken.value) if taken.value else {}
    return taken.add_node(KEY, {**described, **show_all_topics(node)})


def describe(chosen: Foxglove) -> dict[str, Any]:
    """Return the node as a Rigelfile has it; a viewer connects again, so nothing is handed over."""
    port = int(chosen.port)
    parameters: dict[str, Any] = {"port": port}
    if chosen.topics:
        parameters["topic_whitelist"] = list(chosen.topics)
    return {
        "package": PACKAGE,
        "executable": PACKAGE,
        "parameters": parameters,
        "ports": [{"name": str(PORT_NAME), "port": port}],
        "readiness": {"port": port},
        "update": {"strategy": "Recreate"},
    }


def note_image(package: str | None, distro: str) -> dict[str, str]:
    """Return the annotation about what the image of a node needs that runs the bridge."""
    if package != PACKAGE:
        return {}
    return {IMAGE_ANNOTATION: f"its image needs the Debian package ros-{distro}-foxglove-bridge"}


EXTENSION = Extension.of(
    KEY,
    bool | Foxglove,
    "one more node, `foxglove`: the bridge to which Foxglove, Lichtblick and other viewers"
    " connect; true is the mapping with its defaults. An entry `foxglove` in `nodes` is merged"
    " into it",
    expand,
    default=False,
)

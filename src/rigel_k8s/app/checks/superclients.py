"""Tools that see nothing of a graph with discovery servers, unless they are super clients."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import find_program
from rigel_k8s.generation import Generation
from rigel_k8s.problems import Problem

VARIABLE = "ROS_SUPER_CLIENT"
#: Programs that look for topics which they do not know by name; also inside of `bash -c`.
TOOLS = re.compile(r"\bros2 bag record\b|\bfoxglove_bridge\b|\brosbridge_server\b")


def check_super_client(key: str, node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield a warning for a tool that a discovery server shows no topics."""
    line = " ".join(find_program(ros, node))
    found = TOOLS.search(line)
    names = node.env if isinstance(node.env, Mapping) else [one.name for one in node.env]
    if found is None or VARIABLE in line or VARIABLE in map(str, names):
        return
    message = (
        f"{found[0]} does not see all topics, since a discovery server shows them only to super"
        f' clients: set env: {{ {VARIABLE}: "TRUE" }}'
    )
    yield Problem(("nodes", key), message, "no-super-client", severity="warning", at_key=True)

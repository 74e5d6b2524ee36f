"""How a node's components are loaded: a script next to its process, and its input.

The scripts' contract is src/rigel_inpod/README.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.app.components.options import Component
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH, tree, unify_lists
from rigel_k8s.app.programs import run_beside
from rigel_k8s.app.ros1commands import Command, full_name
from rigel_k8s.app.starting import complete_file
from rigel_k8s.objects.naming import Ros
from rigel_k8s.substitution_args import has_substitution

FILE = "components.json"
#: The script that loads, by ROS version.
SCRIPTS: Mapping[Ros, str] = {"1": "nodelets.py", "2": "components.py"}


def load_components(command: Command, ros: Ros, key: str, node: NodeOptions) -> Command:
    """Return a command that also runs the script that loads the node's components."""
    if not node.components or ros == "none":
        return command
    describe = describe_nodelet if ros == "1" else describe_component
    plan = {
        "node": full_name(key, node),
        "components": [describe(key, one) for key, one in node.components.items()],
    }
    files = {**command.files, FILE: json.dumps(plan, indent=1)}
    path = f"{PARAMETERS_PATH}/{FILE}"
    run = run_beside(command, SCRIPTS[ros], path)
    completes = node.substitution_args and has_substitution(plan)
    start = (*command.start, *complete_file(path)) if completes else command.start
    return attrs.evolve(run, files=files, start=start)


def describe_nodelet(key: str, component: Component) -> dict[str, Any]:
    """Return a nodelet for nodelets.py: full names, nested parameters."""
    name = component.full_name(key)
    namespace = name.rpartition("/")[0]
    return {
        "name": name,
        "plugin": component.plugin,
        "parameters": tree(component.parameters),
        "remappings": {
            resolve(str(one), name, namespace): resolve(str(other), name, namespace)
            for one, other in component.remappings.items()
        },
    }


def resolve(name: str, node: str, namespace: str) -> str:
    """Return the full name of a ROS name in a node."""
    if name.startswith("/"):
        return name
    return f"{node}/{name[1:].lstrip('/')}" if name.startswith("~") else f"{namespace}/{name}"


def describe_component(key: str, component: Component) -> dict[str, Any]:
    """Return a composable node for components.py: dotted parameters, remapping rules."""
    return {
        "name": component.full_name(key),
        "package": component.package,
        "plugin": component.plugin,
        "parameters": dict(dotted(component.parameters)),
        "remappings": [f"{one}:={other}" for one, other in component.remappings.items()],
        "extra_arguments": dict(component.extra_arguments),
    }


def dotted(parameters: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield ROS 2's names and values of nested parameters."""
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", unify_lists(value)

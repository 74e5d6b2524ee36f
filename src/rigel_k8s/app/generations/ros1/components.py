"""Nodelets: components of ROS 1, which the node's manager loads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rigel_k8s.app.components import check_values
from rigel_k8s.app.options import Component
from rigel_k8s.app.parameters import tree
from rigel_k8s.generation import Loading
from rigel_k8s.problems import Problem


def describe(key: str, component: Component) -> dict[str, Any]:
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


def check(component: Component) -> Iterator[Problem]:
    """Yield options that a nodelet does not have."""
    for name in ("package", "extra_arguments"):
        if getattr(component, name):
            message = f"a nodelet has no {name}: write its plugin as PACKAGE/CLASS"
            yield Problem((name,), message, "not-ros1", at_key=True)
    yield from check_values(component)


NODELETS = Loading(script="nodelets.py", describe=describe, check=check, are_nodes=False)

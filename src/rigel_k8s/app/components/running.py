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
from rigel_k8s.app.parameters import PARAMETERS_PATH, unify_lists
from rigel_k8s.app.programs import Command, full_name, run_beside
from rigel_k8s.app.starting import complete_file
from rigel_k8s.generation import Loading
from rigel_k8s.problems import Problem
from rigel_k8s.substitution_args import has_substitution

FILE = "components.json"


def load_components(
    command: Command, loading: Loading | None, key: str, node: NodeOptions
) -> Command:
    """Return a command that also runs the script that loads the node's components."""
    if not node.components or loading is None:
        return command
    plan = {
        "node": full_name(key, node),
        "components": [loading.describe(key, one) for key, one in node.components.items()],
    }
    files = {**command.files, FILE: json.dumps(plan, indent=1)}
    path = f"{PARAMETERS_PATH}/{FILE}"
    run = run_beside(command, loading.script, path)
    completes = node.substitution_args and has_substitution(plan)
    start = (*command.start, *complete_file(path)) if completes else command.start
    return attrs.evolve(run, files=files, start=start)


def dotted(parameters: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield ROS 2's names and values of nested parameters."""
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", unify_lists(value)


def check_values(component: Component) -> Iterator[Problem]:
    """Yield parameters of a component without a value."""
    for key, value in component.parameters.items():
        for name, inner in dotted({key: value}):
            if inner is None:
                message = f'the parameter "{name}" has no value'
                yield Problem(("parameters", key), message, "bad-parameter", at_key=True)

"""How the transitions of a lifecycle node are made: a script next to it, and the preStop hook.

Their contract is src/rigel_inpod/README.md.
"""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import Command, full_name, run_beside

STOP = "RIGEL_K8S_TRANSITIONS"


def make_transitions(command: Command, key: str, node: NodeOptions) -> Command:
    """Return a command that also runs the script that makes the transitions at the start."""
    if not node.lifecycle or not node.lifecycle.start:
        return command
    words = ("start", full_name(key, node), *node.lifecycle.start)
    return run_beside(command, "transitions.py", *words)


def list_variables(key: str, node: NodeOptions) -> Mapping[str, dict[str, str]]:
    """Return the variable that makes the preStop hook make the transitions at the end."""
    if not node.lifecycle or not node.lifecycle.stop:
        return {}
    return {STOP: {"value": " ".join([full_name(key, node), *node.lifecycle.stop])}}

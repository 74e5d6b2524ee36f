"""Options of the stack as a Rigelfile gives them, and the stack that they become."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.observability.options import ObservabilityOptions
from rigel_k8s.release.types import Desired
from rigel_k8s.rigelfile import Source, structure
from rigel_k8s.rigelfile.parse import parse
from rigel_stack.manifests.desired import stack_release
from rigel_stack.manifests.stack import Boards, Stack

GOLDEN = Path(__file__).parent / "golden"
#: Short ones: what the real ones say is tested where they are made.
BOARDS = Boards(
    {"rigel-nodes.json": '{"uid": "rigel-nodes"}\n'},
    {
        "rigel-alerts.yaml": yaml.safe_dump(
            {"groups": [{"name": "rigel", "rules": [{"record": "one", "expr": "vector(1)"}]}]}
        )
    },
)


def options(text: str) -> ObservabilityOptions:
    """Return the options that a job's `with` means."""
    node, findings = parse(Source("Rigelfile", text))
    assert node is not None, findings
    assert not findings
    found = structure(node, ObservabilityOptions)
    assert not found.problems, found.problems
    assert isinstance(found.draft, ObservabilityOptions)
    return found.draft


def stack(text: str, **more: Any) -> Stack:
    """Return the stack of a job's `with`."""
    return Stack(options(text), more.pop("namespace", "monitoring"), BOARDS, **more)


def release(text: str, **more: Any) -> Desired:
    """Return what the release of a job's `with` shall be."""
    return stack_release(stack(text, **more), {})


def find(made: Desired, kind: str, name: str) -> dict[str, Any]:
    """Return the one object of a kind and name."""
    (found,) = [i for i in made.objects if i["kind"] == kind and i["metadata"]["name"] == name]
    return dict(found)


def names(made: Desired, kind: str) -> set[str]:
    """Return the names of all objects of a kind."""
    return {str(i["metadata"]["name"]) for i in made.objects if i["kind"] == kind}


def config(made: Desired, name: str, key: str) -> str:
    """Return a text of a ConfigMap."""
    return str(find(made, "ConfigMap", name)["data"][key])

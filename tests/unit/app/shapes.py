"""Options as a Rigelfile gives them, and the objects that they become."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rigel_k8s.app.checks.application import check
from rigel_k8s.app.desired import draft
from rigel_k8s.app.generation import Texts
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.problems import Problem
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.rigelfile import Source, merge_options, structure
from rigel_k8s.rigelfile.expansion import Surroundings, expand
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.settings import Application

GOLDEN = Path(__file__).parent / "golden"
SCRIPTS = {"ready.sh": "exit 0\n", "stop.sh": "exit 0\n"}
LIBRARIES = {"rmw-x86_64.so": b"\x7fELF"}


def options(text: str) -> OrchestrationOptions:
    """Return the options that a job's `with` means."""
    node, findings = parse(Source("Rigelfile", text))
    assert node is not None, findings
    assert not findings
    merged = merge_options(node, None, OrchestrationOptions)
    expanded = expand(merged, OrchestrationOptions, Surroundings(Path(), None, {}, None))
    assert not expanded.findings
    found = structure(expanded.node, OrchestrationOptions)
    assert not found.problems
    assert isinstance(found.draft, OrchestrationOptions)
    return found.draft


def distro_of(text: str) -> str:
    """Return the distribution that a golden file's first line tells, noetic where it does not."""
    told = re.match(r"# distro: (\w+)", text)
    return told[1] if told else "noetic"


def problems(text: str, distro: str | None = None) -> list[Problem]:
    """Return what the checks say of a job's `with`."""
    return list(check(options(text), distro or distro_of(text)))


def release(text: str, **more: Any) -> Desired:
    """Return what a job's `with` becomes in the namespace `robots`.

    Args:
        more: `change` takes the options and returns others; the rest as draft and finish.
    """
    chosen = more.pop("change", lambda made: made)(options(text))
    drafted = draft(
        chosen,
        ReleaseId("robots", str(chosen.deployment_name)),
        Application(more.pop("distro", distro_of(text))),
        Texts(
            SCRIPTS,
            more.pop("files", {}),
            libraries=more.pop("libraries", LIBRARIES),
            folders=more.pop("folders", {}),
        ),
        previous=more.pop("previous", ()),
    )
    made = drafted.finish(**more)
    json.dumps(made.objects)
    return made


def find(made: Desired, kind: str, name: str) -> dict[str, Any]:
    """Return one object."""
    found = [m for m in made.objects if m["kind"] == kind and m["metadata"]["name"] == name]
    assert found, f"no {kind} {name} among {[m['metadata']['name'] for m in made.objects]}"
    return dict(found[0])


def pod(made: Desired, name: str) -> dict[str, Any]:
    """Return the pod's spec of a Deployment."""
    spec: dict[str, Any] = find(made, "Deployment", name)["spec"]["template"]["spec"]
    return spec


def container(made: Desired, name: str) -> dict[str, Any]:
    """Return the first container of a Deployment."""
    first: dict[str, Any] = pod(made, name)["containers"][0]
    return first


def env(made: Desired, name: str) -> Mapping[str, Any]:
    """Return the variables of a Deployment's first container."""
    return {e["name"]: e.get("value", e.get("valueFrom")) for e in container(made, name)["env"]}

"""init, check, schema: what needs only a Rigelfile."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import attrs

from rigel_k8s import rigelfile as grammar
from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.errors import UserError
from rigel_k8s.jobs import registry
from rigel_k8s.jobs.names import Kind
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import CheckResult
from rigel_k8s.rigelfile.findings import Finding, sort_findings, suggest
from rigel_k8s.rigelfile.model import Rigelfile
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.ros import DISTROS
from rigel_k8s.settings import Settings


def load(settings: Settings, *, patient: bool = False) -> Rigelfile:
    """Return the Rigelfile of the settings.

    Args:
        patient: undefined variables are wrong only where a value is needed.

    Raises:
        UserError: it does not exist, with what to do.
        ProblemsError: its grammar is wrong.
    """
    require(settings.rigelfile)
    return grammar.load(settings.rigelfile, os.environ, patient=patient)


def list_runnable(settings: Settings, kind: Literal["job", "sequence"]) -> list[str]:
    """Return the names that can be run. Raises as load."""
    rigelfile = load(settings)
    return list(rigelfile.jobs if kind == "job" else rigelfile.sequences)


def read_value(text: str) -> Any:
    """Return a scalar as the Rigelfile's values are read: a number, a boolean, a text."""
    root, findings = parse(grammar.Source("", text))
    if root is None or findings or isinstance(root.value, dict | list):
        return text
    return root.value


def require(path: Path) -> None:
    """Refuse a path without a Rigelfile."""
    if path.is_dir():
        raise UserError(f"{path} is a directory", hint=f"name the file: -f {path / 'Rigelfile'}")
    if not path.is_file():
        raise UserError(
            f"{path} does not exist",
            hint="write one with `rigel init`, or choose another with -f FILE",
        )


def check(settings: Settings) -> CheckResult:
    """Return every problem of the Rigelfile, with our job types' own checks.

    How two jobs of a sequence affect each other is checked only if each of them is right.
    """
    from rigel_k8s.jobs.runner import check_sequence

    require(settings.rigelfile)
    directory = settings.rigelfile.absolute().parent

    result = grammar.check_file(
        settings.rigelfile, os.environ, partial(registry.resolve, directory)
    )
    if result.rigelfile is None or result.errors:
        return result
    found = dict.fromkeys([*result.findings, *check_names(result.rigelfile, directory)])
    for name in result.rigelfile.sequences:
        found.update(dict.fromkeys(check_sequence(result.rigelfile, name, settings)))
    return attrs.evolve(result, findings=sort_findings(found))


def check_names(rigelfile: Rigelfile, directory: Path) -> Iterator[Finding]:
    """Yield plugins that Rigel 0.3, where it is installed, could not import."""
    if find_spec("rigel") is None or (directory / "src" / "plugin.py").exists():
        return
    for spec in rigelfile.jobs.values():
        if spec.plugin.startswith("src.plugin."):
            message = (
                "Rigel 0.3, which is installed here, cannot load it: src/plugin.py does not exist;"
                " write rigel_k8s.OrchestrationPlugin, which both read"
            )
            path = (*spec.path, "plugin")
            problem = Problem(path, message, "no-plugin", severity="warning")
            yield grammar.place(rigelfile.root, problem)


def init(path: Path, *, ros: str | None, force: bool) -> None:
    """Write a commented Rigelfile.

    Args:
        ros: for which ROS, "1", "2" or a distribution; None: that of the shell, if it has one.

    Raises:
        UserError: it already exists, and not `force`; or there is no such distribution.
    """
    if path.exists() and not force:
        raise UserError(f"{path} already exists", hint="overwrite it with --force")
    known = {name: ros for ros, names in DISTROS.items() for name in (ros, *names)}
    own = os.environ.get("ROS_DISTRO", "")
    ros = ros or (own if own in known else "2")
    if ros not in known:
        raise UserError(f'"{ros}" is no distribution of ROS{suggest(ros, known)}')
    starter = GENERATIONS[known[ros]].starter
    words = starter if ros in DISTROS else {**starter, "distro": ros}
    path.write_text(grammar.render_starter(words))


def schema() -> dict[str, Any]:
    """Return the JSON schema of Rigelfiles with our job types and providers."""
    return grammar.schema(list_option_classes("job"), list_option_classes("provider"))


def list_option_classes(kind: Kind) -> dict[tuple[str, ...], type[Any]]:
    """Return the option class of each known job type or provider, by all its names."""
    find = registry.job_type if kind == "job" else registry.provider_type
    return {
        (short, *paths): find(short).options for short, paths in registry.list_names(kind).items()
    }

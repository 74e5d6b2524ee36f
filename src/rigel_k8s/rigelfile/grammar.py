"""From a rendered tree to the model, with all faults in the grammar at once.

Sections and their entries are checked one by one: a fault in one does not hide others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path as FilePath
from string import Template
from typing import Any

import attrs

from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem
from rigel_k8s.rigelfile.findings import Finding, place, suggest
from rigel_k8s.rigelfile.limits import MOST_SUGGESTIONS
from rigel_k8s.rigelfile.model import (
    ApplicationEntry,
    ComponentSpec,
    JobEntry,
    ProviderEntry,
    Sections,
    SequenceSpec,
)
from rigel_k8s.rigelfile.source import Span, YamlNode, kind_of, locate
from rigel_k8s.rigelfile.structure import structure
from rigel_k8s.settings import Application


@attrs.frozen
class Contents:
    """What could be read of a Rigelfile, and what is wrong; entries with a fault are left out."""

    application: Application | None
    jobs: Mapping[str, ComponentSpec]
    providers: Mapping[str, ComponentSpec]
    sequences: Mapping[str, SequenceSpec]
    findings: tuple[Finding, ...]


def read(root: YamlNode, directory: FilePath, known: list[Finding]) -> Contents:
    """Return the contents of a rendered tree, a mapping.

    Args:
        root: the tree.
        directory: the Rigelfile's own, to which `application.dir` is relative.
        known: findings about its templates.
    """
    reader = _Reader(root, known)
    reader.entry((), Sections)
    application = reader.application(directory)
    jobs = reader.components("jobs", JobEntry)
    providers = reader.components("providers", ProviderEntry)
    sequences = reader.sequences()
    reader.find_faults_of_stages()
    return Contents(application, jobs, providers, sequences, tuple(reader.findings))


def list_uses(step: YamlNode, path: Path = ()) -> Iterator[tuple[Path, YamlNode]]:
    """Yield each entry of a stage's jobs and dependencies, with its path."""
    yield from _list_entries(step, path, "dependencies")
    yield from _list_entries(step, path, "jobs")


def list_steps(root: YamlNode) -> Iterator[tuple[Path, YamlNode]]:
    """Yield each sequence, each of its stages and each stage in those, with its path."""
    for path, sequence in _list_entries(root, (), "sequences"):
        yield path, sequence
        for stage_path, stage in _list_entries(sequence, path, "stages"):
            yield stage_path, stage
            yield from _list_entries(stage, stage_path, "parallel")


def used_name(use: YamlNode) -> str | None:
    """Return the job that an entry of a stage names, as written; None if it is not a name yet.

    A number is also a name: `jobs: {1.5: ...}` declares the job that `jobs: [1.5]` uses.
    """
    name = use.value.get("name") if isinstance(use.value, dict) else use
    if name is None or name.hole:
        return None
    number = isinstance(name.value, int | float) and not isinstance(name.value, bool)
    return name.raw if number else name.value if isinstance(name.value, str) else None


def _find(node: YamlNode, key: str) -> Any:
    """Return the value of a key, None without it."""
    child = node.value.get(key) if isinstance(node.value, dict) else None
    return child and child.value


def _list_entries(node: YamlNode, path: Path, key: str) -> Iterator[tuple[Path, YamlNode]]:
    """Yield the entries of the mapping or list under a key, if it is one."""
    inner = node.value.get(key) if isinstance(node.value, dict) else None
    for step, child in inner.entries() if inner else ():
        yield (*path, key, step), child


class _Reader:
    def __init__(self, root: YamlNode, known: list[Finding]) -> None:
        self.findings: list[Finding] = []
        self._root = root
        self._known = known

    def entry(self, path: Path, kind: Any) -> Any | None:
        """Return the value at a path as a part of the model; None, and a report, if it is not."""
        node = locate(self._root, path)
        result = structure(node, kind)
        problems = [problem.under(path) for problem in result.problems]
        self.findings += [place(self._root, problem) for problem in problems]
        waiting = [*result.doubts.texts, *result.doubts.missing]
        for doubt in waiting:
            found = locate(node, doubt)
            if found.hole:
                self._refuse_hole(found.span)
            elif doubt and has_template(str(doubt[-1])):
                self._refuse_hole(found.key_span or found.span)
        return None if result.problems or waiting else result.draft

    def _refuse_hole(self, span: Span) -> None:
        """Report that data is not available yet, unless the template there is already reported."""
        lines = range(span.line, span.end_line + 1)
        if not any(finding.span.line in lines for finding in self._known):
            message = "data.x is known when a job runs: only `with` and `matrix` may wait for it"
            self.findings.append(Finding(span, message, "template"))

    def application(self, directory: FilePath) -> Application | None:
        if "application" not in self._root.value:
            return None
        found = self.entry(("application",), ApplicationEntry)
        return Application(found.distro, directory / found.dir) if found else None

    def _section(self, name: str, kind: type[Any]) -> Iterator[tuple[Path, YamlNode, Any]]:
        """Yield the valid entries of a section: path, Node, and what it means."""
        if isinstance(_find(self._root, name), dict):
            for path, node in _list_entries(self._root, (), name):
                if found := self.entry(path, kind):
                    yield path, node, found

    def components(self, section: str, kind: type[Any]) -> dict[str, ComponentSpec]:
        specs = [
            ComponentSpec(
                str(path[-1]), found.plugin, found.options or attrs.evolve(node, value={}), path
            )
            for path, node, found in self._section(section, kind)
        ]
        return {spec.name: spec for spec in specs}

    def sequences(self) -> dict[str, SequenceSpec]:
        return {str(path[-1]): found for path, _, found in self._section("sequences", SequenceSpec)}

    def find_faults_of_stages(self) -> None:
        """Report empty lists, matrices that are not valid, and jobs that the file does not have."""
        jobs = _find(self._root, "jobs")
        known = jobs if isinstance(jobs, dict) else {}
        for path, step in list_steps(self._root):
            for key in ("stages", "jobs", "parallel"):
                if _find(step, key) == []:
                    self._report((*path, key), f"`{key}` is empty: nothing would run", "empty")
            if isinstance(_find(step, "matrix"), dict):
                self._find_faults_of_matrix(step, path)
            for use_path, use in list_uses(step, path):
                name = used_name(use)
                if name is not None and name not in known:
                    where = (*use_path, "name") if isinstance(use.value, dict) else use_path
                    few = len(self.findings) < MOST_SUGGESTIONS
                    message = f'unknown job "{name}"{suggest(name, known) if few else ""}'
                    self._report(where, message, "unknown-job")

    def _find_faults_of_matrix(self, step: YamlNode, path: Path) -> None:
        for key_path, values in _list_entries(step, path, "matrix"):
            if values.value == []:
                self._report(key_path, f"{key_path[-1]} has no values: nothing would run", "empty")
            elif not isinstance(values.value, list) and not values.hole:
                message = f"expected a list of values, got {kind_of(values.value)}"
                self._report(key_path, message, "wrong-type")

    def _report(self, path: Path, message: str, kind: str) -> None:
        self.findings.append(place(self._root, Problem(path, message, kind)))


def render_starter(words: Mapping[str, str]) -> str:
    """Return the Rigelfile with the words of a generation of ROS."""
    text = (files(__package__) / "starter.Rigelfile").read_text("utf-8")
    return Template(text).substitute(words)

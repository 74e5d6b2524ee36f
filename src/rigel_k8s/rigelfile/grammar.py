"""From a rendered tree to the model, with all faults in the grammar at once.

Sections and their entries are checked one by one: a fault in one does not hide others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path as FilePath
from typing import Any

import attrs

from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem
from rigel_k8s.rigelfile.findings import Finding, place, suggest
from rigel_k8s.rigelfile.forms import (
    ApplicationForm,
    ConcurrentForm,
    JobForm,
    JobUseForm,
    ParallelForm,
    ProviderForm,
    RigelfileForm,
    SequenceForm,
    SequentialForm,
)
from rigel_k8s.rigelfile.limits import MOST_SUGGESTIONS
from rigel_k8s.rigelfile.model import (
    ComponentSpec,
    Concurrent,
    JobUse,
    Parallel,
    SequenceSpec,
    Sequential,
    Stage,
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
    """Return the contents of a rendered tree.

    Args:
        root: the tree.
        directory: the Rigelfile's own, to which `application.dir` is relative.
        known: findings about its templates.
    """
    reader = _Reader(root, known)
    reader.entry((), RigelfileForm)
    application = reader.application(directory)
    jobs = reader.components("jobs", JobForm)
    providers = reader.components("providers", ProviderForm)
    sequences = reader.sequences()
    reader.references()
    return Contents(application, jobs, providers, sequences, tuple(reader.findings))


def uses(root: YamlNode) -> Iterator[tuple[Path, YamlNode]]:
    """Yield each entry of a stage's jobs and dependencies, with its path."""
    for path, sequence in _entries(root, ("sequences",)):
        for stage_path, stage in _entries(sequence, ("stages",), path):
            yield from _stage_uses(stage, stage_path)


def _stage_uses(stage: YamlNode, path: Path) -> Iterator[tuple[Path, YamlNode]]:
    yield from _entries(stage, ("dependencies",), path)
    yield from _entries(stage, ("jobs",), path)
    for inner_path, inner in _entries(stage, ("parallel",), path):
        yield from _stage_uses(inner, inner_path)


def used_name(use: YamlNode) -> str | None:
    """Return the job that an entry of a stage names, as written; None if it is not a name yet.

    A number is also a name: `jobs: {1.5: ...}` declares the job that `jobs: [1.5]` uses.
    """
    name = use.value.get("name") if isinstance(use.value, dict) else use
    if name is None or name.hole:
        return None
    number = isinstance(name.value, int | float) and not isinstance(name.value, bool)
    return name.raw if number else name.value if isinstance(name.value, str) else None


def _entries(node: YamlNode, keys: Path, path: Path = ()) -> Iterator[tuple[Path, YamlNode]]:
    """Yield the entries of the mapping or list under a key, if it is one."""
    if not isinstance(node.value, dict) or keys[0] not in node.value:
        return
    inner = node.value[str(keys[0])].value
    if isinstance(inner, dict):
        yield from (((*path, *keys, key), child) for key, child in inner.items())
    elif isinstance(inner, list):
        yield from (((*path, *keys, number), child) for number, child in enumerate(inner))


class _Reader:
    def __init__(self, root: YamlNode, known: list[Finding]) -> None:
        self.findings: list[Finding] = []
        self._root = root
        self._known = known

    def report(self, path: Path, message: str, kind: str) -> None:
        self.findings.append(place(self._root, Problem(path, message, kind)))

    def entry(self, path: Path, kind: Any) -> Any | None:
        """Return the value at a path as a form; None, and a report, if it does not fit."""
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

    def section(self, name: str) -> Iterator[tuple[Path, YamlNode]]:
        node = self._root.value.get(name) if isinstance(self._root.value, dict) else None
        if node is not None and isinstance(node.value, dict):
            yield from _entries(self._root, (name,))

    def application(self, directory: FilePath) -> Application | None:
        if not isinstance(self._root.value, dict) or "application" not in self._root.value:
            return None
        form = self.entry(("application",), ApplicationForm)
        return Application(form.distro, directory / form.dir) if form else None

    def components(self, section: str, kind: type[Any]) -> dict[str, ComponentSpec]:
        found = {}
        for path, node in self.section(section):
            form = self.entry(path, kind)
            if form:
                name = str(path[-1])
                plugin = form.plugin if isinstance(form, JobForm) else form.provider
                options = form.options or attrs.evolve(node, value={})
                found[name] = ComponentSpec(name, plugin, options, path)
        return found

    def sequences(self) -> dict[str, SequenceSpec]:
        found = {}
        for path, node in self.section("sequences"):
            form = self.entry(path, SequenceForm)
            self._empty(path, node)
            if form:
                found[str(path[-1])] = _sequence(form, path)
        return found

    def _empty(self, path: Path, sequence: YamlNode) -> None:
        """Report empty lists, and matrices that are not valid."""
        self._matrix(path, sequence)
        self._no_entries(path, sequence, "stages")
        for stage_path, stage in _entries(sequence, ("stages",), path):
            self._matrix(stage_path, stage)
            self._no_entries(stage_path, stage, "jobs", "parallel")
            for inner_path, inner in _entries(stage, ("parallel",), stage_path):
                self._no_entries(inner_path, inner, "jobs")

    def _no_entries(self, path: Path, node: YamlNode, *keys: str) -> None:
        for key in keys:
            child = node.value.get(key) if isinstance(node.value, dict) else None
            if child and child.value == []:
                self.report((*path, key), f"`{key}` is empty: nothing would run", "empty")

    def _matrix(self, path: Path, node: YamlNode) -> None:
        matrix = node.value.get("matrix") if isinstance(node.value, dict) else None
        if not matrix or not isinstance(matrix.value, dict):
            return
        for place_, values in _entries(node, ("matrix",), path):
            if values.value == []:
                self.report(place_, f"{place_[-1]} has no values: nothing would run", "empty")
            elif not isinstance(values.value, list) and not values.hole:
                message = f"expected a list of values, got {kind_of(values.value)}"
                self.report(place_, message, "wrong-type")

    def references(self) -> None:
        """Report jobs that stages name but the file does not declare."""
        section = self._root.value.get("jobs") if isinstance(self._root.value, dict) else None
        known = section.value if section and isinstance(section.value, dict) else {}
        for path, use in uses(self._root):
            name = used_name(use)
            if name is not None and name not in known:
                where = (*path, "name") if isinstance(use.value, dict) else path
                few = len(self.findings) < MOST_SUGGESTIONS
                message = f'unknown job "{name}"{suggest(name, known) if few else ""}'
                self.report(where, message, "unknown-job")


def _sequence(form: SequenceForm, path: Path) -> SequenceSpec:
    stages = tuple(_stage(s, (*path, "stages", n)) for n, s in enumerate(form.stages))
    return SequenceSpec(str(path[-1]), stages, form.matrix, form.description or None)


def _stage(form: SequentialForm | ConcurrentForm | ParallelForm, path: Path) -> Stage:
    if isinstance(form, ParallelForm):
        inner = tuple(_jobs(s, (*path, "parallel", n)) for n, s in enumerate(form.parallel))
        return Parallel(inner, form.matrix, form.description or None)
    return _jobs(form, path)


def _jobs(form: SequentialForm | ConcurrentForm, path: Path) -> Sequential | Concurrent:
    jobs = _uses(form.jobs, (*path, "jobs"))
    if isinstance(form, SequentialForm):
        return Sequential(jobs, form.description or None)
    dependencies = _uses(form.dependencies, (*path, "dependencies"))
    return Concurrent(jobs, dependencies, form.description or None)


def _uses(entries: list[str | JobUseForm], path: Path) -> tuple[JobUse, ...]:
    return tuple(
        JobUse(entry.name, entry.options, (*path, number))
        if isinstance(entry, JobUseForm)
        else JobUse(entry, None, (*path, number))
        for number, entry in enumerate(entries)
    )

"""A job's `with` as its plugin's options: overrides applied, data filled in, structured."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import attrs

from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile.expansion import Surroundings, expand
from rigel_k8s.rigelfile.fields import nesting_key
from rigel_k8s.rigelfile.findings import Finding, make_finding, place, problems_error, sort_findings
from rigel_k8s.rigelfile.limits import MOST_PROBLEMS
from rigel_k8s.rigelfile.model import ComponentSpec, Rigelfile
from rigel_k8s.rigelfile.scope import Scope
from rigel_k8s.rigelfile.source import Source, YamlNode, kind_of, strip_places
from rigel_k8s.rigelfile.spending import bounded
from rigel_k8s.rigelfile.structure import Doubts, structure
from rigel_k8s.settings import Application

O_contra = TypeVar("O_contra", contravariant=True)  # the options of a job type


@runtime_checkable
class ReadsFiles(Protocol[O_contra]):
    """A job type whose options name files: `rigel check` reads them, and a run before the job."""

    def check_files(
        self, options: O_contra, application: Application, home: Path
    ) -> Sequence[Problem]:
        """Return what is wrong with the files; `home` is the Rigelfile's directory."""


@runtime_checkable
class ReadsJobs(Protocol[O_contra]):
    """A job type whose options name other jobs of the Rigelfile."""

    def check_jobs(self, options: O_contra, jobs: Mapping[str, ComponentSpec]) -> Sequence[Problem]:
        """Return what is wrong with that; `jobs` are all of them by name. Pure, as `check`."""


@attrs.frozen
class Preview:
    """Options as far as they are known.

    Attributes:
        options: None if something is wrong, or not enough is known. A text that waits for data
            contains its template, another value that waits is its field's default.
        raw: the `with` as plain data.
        findings: what is wrong with it, and warnings.
        complete: nothing waits for data.
        draft: the options even if something is wrong, with defaults in those places.
        node: what the options were made from; paths of problems begin there.
    """

    options: Any
    raw: dict[str, Any]
    findings: tuple[Finding, ...]
    complete: bool
    draft: Any
    node: YamlNode
    doubts: Doubts

    def place_problems(self, problems: Iterable[Problem]) -> tuple[Finding, ...]:
        """Return problems with the draft as findings, without those that a doubt may explain."""
        explains = self.doubts.may_explain
        sure = (one for one in problems if not any(map(explains, (one.path, *one.because))))
        shown = itertools.islice(sure, 2 * MOST_PROBLEMS)
        return tuple(place(self.node, problem) for problem in shown)

    def check(
        self, kind: Any, application: Application, jobs: Mapping[str, ComponentSpec]
    ) -> tuple[Finding, ...]:
        """Return what the checks of a job type or provider find in the draft."""
        findings = self.place_problems(kind.check(self.draft, application))
        if isinstance(kind, ReadsJobs):
            findings += self.place_problems(kind.check_jobs(self.draft, jobs))
        return findings

    def check_files(
        self, kind: Any, application: Application, source: Source
    ) -> tuple[Finding, ...]:
        """Return what is wrong with the files that the draft names."""
        if not isinstance(kind, ReadsFiles):
            return ()
        home = Path(source.name).absolute().parent
        return self.place_problems(kind.check_files(self.draft, application, home))


def preview(
    rigelfile: Rigelfile,
    spec: ComponentSpec,
    overrides: YamlNode | None,
    data: Mapping[str, Any] | None,
    options: type[Any],
) -> Preview:
    """Return a component's options as far as they are known; never raises for what is wrong."""
    scope = rigelfile.scope.with_data(data, final=False)
    return look(scope, spec, overrides, options, rigelfile.application.dir)


def realise(
    rigelfile: Rigelfile,
    spec: ComponentSpec,
    overrides: YamlNode | None,
    data: Mapping[str, Any],
    options: type[Any],
) -> Preview:
    """Return a component's options when it runs; their findings are warnings.

    Raises:
        ProblemsError: something is wrong with them, or data is missing; with the places.
    """
    scope = rigelfile.scope.with_data(data, final=True)
    seen = look(scope, spec, overrides, options, rigelfile.application.dir)
    if seen.options is None:
        raise problems_error(rigelfile.source, seen.findings)
    return seen


def look(
    scope: Scope,
    spec: ComponentSpec,
    overrides: YamlNode | None,
    options: type[Any],
    directory: Path | None,
) -> Preview:
    """Return a component's options as far as their values are in a scope.

    Args:
        directory: the application's, where files are that the options name; None: unknown.
    """
    merged = merge_options(spec.options, overrides)
    scope.add_look(merged)
    with bounded(scope.source, merged):
        node = written = scope.fill(merged)
        findings = [*scope.findings]
        if under := nesting_key(options):
            findings += _find_nesting_faults(under, spec.options, overrides)
            base = written if merged is spec.options else scope.fill(spec.options)
            node = merge_options(base, overrides and scope.fill(overrides), options)
        expanded = expand(node, options, Surroundings.of(scope, directory))
        findings += expanded.findings
        result = structure(expanded.node, Any if options is dict else options)
    findings += [place(expanded.node, problem) for problem in result.problems]
    wrong = any(finding.severity == "error" for finding in findings)
    return Preview(
        options=None if wrong else result.draft,
        raw=strip_places(written if expanded.node is node else expanded.node),
        findings=sort_findings(findings),
        complete=result.complete,
        draft=result.draft,
        node=expanded.node,
        doubts=result.doubts,
    )


def merge_options(options: YamlNode, overrides: YamlNode | None, kind: Any = None) -> YamlNode:
    """Return options with keys replaced by those of the overrides, as Rigel does.

    If the options may be below a key of their own (`nested_under`), that level is removed
    from the result.
    """
    over = overrides.value if overrides else {}
    under = nesting_key(kind)
    if not under:
        return attrs.evolve(options, value={**options.value, **over}) if over else options
    nested = _find_nested(overrides, under) or {}
    direct = {key: node for key, node in options.value.items() if key not in nested}
    result = {**(nested or _find_nested(options, under) or {}), **direct, **over}
    result.pop(under, None)
    return attrs.evolve(options, value=result)


def _find_nested(node: YamlNode | None, under: str) -> dict[str, YamlNode] | None:
    inner = node.value.get(under) if node else None
    return inner.value if inner and isinstance(inner.value, dict) else None


def _find_nesting_faults(under: str, *nodes: YamlNode | None) -> Iterator[Finding]:
    """Yield keys that are both below the options' own key and next to it."""
    for node in nodes:
        if not node or under not in node.value:
            continue
        inner = node.value[under]
        if not isinstance(inner.value, dict) and not inner.hole:
            message = f"expected a mapping, got {kind_of(inner.value)}"
            yield make_finding(inner, message, "wrong-type")
        for key in (_find_nested(node, under) or {}).keys() & node.value.keys():
            message = f'"{key}" is also below `{under}`: remove one'
            yield make_finding(node.value[key], message, "duplicate-key", key=True)

"""Reads and checks a file as a whole: for a run, which stops at problems, and for `rigel check`."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.rigelfile.findings import (
    Finding,
    make_finding,
    problems_error,
    render,
    sort_findings,
)
from rigel_k8s.rigelfile.grammar import Contents, list_steps, list_uses, read, used_name
from rigel_k8s.rigelfile.limits import LONGEST_LINE, MOST_BYTES, MOST_PROBLEMS
from rigel_k8s.rigelfile.model import ComponentSpec, Rigelfile
from rigel_k8s.rigelfile.options import look
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.scope import Scope
from rigel_k8s.rigelfile.source import Source, Span, YamlNode, kind_of, locate
from rigel_k8s.rigelfile.spending import TooLarge, bounded, refuse_depth
from rigel_k8s.system.local_files import read_text
from rigel_k8s.system.trust import Untrusted

ComponentKind: TypeAlias = Literal["job", "provider"]
#: The kind ("job" or "provider") and the name behind `plugin:` or `provider:`, to a type with
#: `options` and `check`; UserError if it does not exist.
Resolve: TypeAlias = Callable[[ComponentKind, str], Any]


@attrs.frozen
class CheckResult:
    """What a check found; `rigelfile` is None where the grammar is wrong."""

    source: Source
    findings: tuple[Finding, ...]
    rigelfile: Rigelfile | None = None

    @property
    def errors(self) -> tuple[Finding, ...]:
        """What stops a run."""
        return tuple(f for f in self.findings if f.severity == "error")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        return tuple(f for f in self.findings if f.severity == "warning")

    def render_findings(self, width: int = LONGEST_LINE) -> list[str]:
        """Return all findings as text with the lines they are about, `width` columns wide."""
        return [render(self.source, finding, width=width) for finding in self.findings]


def open_source(path: Path) -> Source:
    """Return a file's text.

    Raises:
        UserError: it cannot be read.
    """
    try:
        return Source(str(path), read_text(path, path.parent, MOST_BYTES, what=str(path)))
    except FileNotFoundError as error:
        hint = "write one with `rigel init`, or choose another file with -f"
        raise UserError(f"{path} does not exist", hint=hint) from error
    except UnicodeDecodeError as error:
        message = f"{path} is not UTF-8: byte {error.start} is {error.object[error.start]:#x}"
        raise UserError(message, hint="save it as UTF-8") from error
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}") from error


def load(
    path: Path, environ: Mapping[str, str] = os.environ, *, patient: bool = False
) -> Rigelfile:
    """Return a Rigelfile whose grammar and vars are right.

    Args:
        patient: undefined variables are holes, wrong only where a value is needed; no
            other machine is asked for files that the options import.

    Raises:
        ProblemsError: they are not; with all problems.
        UserError: it cannot be read.
    """
    fetched: dict[str, str] | None = None if patient else {}
    reading = _read(open_source(path), path, environ, patient=patient, fetched=fetched)
    if reading.rigelfile is None:
        raise problems_error(reading.source, reading.findings)
    return reading.rigelfile


def check_file(path: Path, environ: Mapping[str, str], resolve: Resolve) -> CheckResult:
    """Return everything that is wrong with a Rigelfile, options included.

    Raises:
        UserError: it cannot be read.
    """
    source = open_source(path)
    try:
        reading = _read(source, path, environ)
        findings = list(reading.findings)
        if reading.contents:
            components = _Components(reading.root, reading.scope, reading.contents, resolve)
            findings += itertools.islice(components.findings(), 2 * MOST_PROBLEMS)
    except TooLarge as error:
        return CheckResult(source, (error.finding,))
    return CheckResult(reading.source, sort_findings(findings), reading.rigelfile)


_NOTHING = YamlNode({}, Span(1, 1, 1, 2))


@attrs.frozen
class _Reading:
    """A file as far as it can be read."""

    source: Source
    root: YamlNode
    scope: Scope
    findings: tuple[Finding, ...]
    contents: Contents | None = None

    @property
    def rigelfile(self) -> Rigelfile | None:
        """The Rigelfile; None where something is wrong with it."""
        found = self.contents
        if self.findings or found is None or found.application is None:
            return None
        return Rigelfile(
            source=self.source,
            root=self.root,
            application=found.application,
            jobs=found.jobs,
            providers=found.providers,
            sequences=found.sequences,
            scope=self.scope,
        )


def _read(
    source: Source,
    path: Path,
    environ: Mapping[str, str],
    *,
    patient: bool = False,
    fetched: MutableMapping[str, str] | None = None,
) -> _Reading:
    """Parse a file, fill in its vars, and compare it with the grammar."""
    with bounded(source, _NOTHING):
        root, findings = parse(source)
        root = root or _NOTHING
        section = root.value.get("vars") if isinstance(root.value, dict) else None
        variables = section.value if section and isinstance(section.value, dict) else {}
        scope = Scope(source, variables, environ, patient=patient, fetched=fetched)
        contents = None
        if root is not _NOTHING and isinstance(root.value, dict):
            root = _render_tree(root, scope)
            refuse_depth(source, root)
            findings += scope.findings
            contents = read(root, path.parent, findings)
            findings += contents.findings
        elif root is not _NOTHING:
            message = f"expected a mapping with application and jobs, got {kind_of(root.value)}"
            findings.append(make_finding(root, message, "wrong-type"))
        return _Reading(source, root, scope, sort_findings(findings), contents)


def _render_tree(root: YamlNode, scope: Scope) -> YamlNode:
    """Return the tree with vars filled in; each var is rendered once, however often it is used."""
    section = root.value.get("vars")
    if section is None or not isinstance(section.value, dict):
        return scope.render(root)
    rest = {key: node for key, node in root.value.items() if key != "vars"}
    variables = attrs.evolve(section, value=scope.render_variables())
    rendered = scope.render(attrs.evolve(root, value=rest))
    return attrs.evolve(rendered, value={"vars": variables, **rendered.value})


class _Components:
    """The options of every job and provider, even if the grammar is wrong elsewhere."""

    def __init__(self, root: YamlNode, scope: Scope, contents: Contents, resolve: Resolve) -> None:
        self._root = root
        self._scope = scope
        self._contents = contents
        self._resolve = cache(resolve)
        self._used: dict[str | None, dict[int, YamlNode | None]] = {}
        for _, step in list_steps(root):
            for _, use in list_uses(step):
                options = use.value.get("with") if isinstance(use.value, dict) else None
                usable = options if options and isinstance(options.value, dict) else None
                self._used.setdefault(used_name(use), {})[id(usable)] = usable

    def findings(self) -> Iterator[Finding]:
        for spec in self._contents.providers.values():
            yield from self._check("provider", spec, [None])
        for spec in self._contents.jobs.values():
            yield from self._check("job", spec, self._uses(spec.name))

    def _uses(self, job: str) -> list[YamlNode | None]:
        """Return the overrides with which a job is used; None for its own options alone.

        A job that is only used with overrides may leave keys to them.
        """
        return list(self._used.get(job, {}).values()) or [None]

    def _check(
        self, kind: ComponentKind, spec: ComponentSpec, overrides: list[YamlNode | None]
    ) -> Iterator[Finding]:
        found = find_type(self._root, kind, spec, self._resolve)
        if isinstance(found, Finding):
            yield found
            return
        application, source = self._contents.application, self._scope.source
        for over in overrides:
            scope = self._scope.with_data(None, final=False)
            directory = application.dir if application else None
            seen = look(scope, spec, over, found.options, directory)
            yield from seen.findings
            if seen.draft is not None and application is not None:
                yield from seen.check(found, application, self._contents.jobs)
                yield from seen.check_files(found, application, source)


def find_type(
    root: YamlNode, kind: ComponentKind, spec: ComponentSpec, resolve: Resolve
) -> Any | Finding:
    """Return the type of a job or provider, or why its name does not lead to one."""
    try:
        return resolve(kind, spec.plugin)
    except UserError as error:
        hint = f" ({error.hint})" if error.hint else ""
        message = "; ".join((error.message, *error.details)) + hint
        key = "plugin" if kind == "job" else "provider"
        slug = "untrusted" if isinstance(error, Untrusted) else f"unknown-{key}"
        return make_finding(locate(root, (*spec.path, key)), message, slug)

"""What Rigel 0.3 would refuse in a Rigelfile (errors), or read differently (warnings).

What both refuse is not reported here but by check_file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import attrs

from rigel_k8s.option_text import has_template
from rigel_k8s.rigelfile.check import CheckResult, open_source
from rigel_k8s.rigelfile.findings import Finding, make_finding, sort_findings
from rigel_k8s.rigelfile.model import LIMITS
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import YamlNode, kind_of
from rigel_k8s.rigelfile.template import Expression, Name, parts

KIND = "rigel03"
#: What Rigel 0.3 accepts as a name: it removes the blanks and looks up the rest.
_NAME = re.compile(r"\{\{[a-zA-Z0-9_\s\-!?.]+\}\}")

Rule = Callable[[YamlNode], Iterator[Finding]]


def rigel03(path: Path, environ: Mapping[str, str] = os.environ) -> CheckResult:
    """Return how Rigel 0.3 reads a file that passes a check.

    Raises:
        UserError: it cannot be read.
    """
    source = open_source(path)
    root, _ = parse(source)
    if root is None or not isinstance(root.value, dict):
        return CheckResult(source, ())
    rules: tuple[Rule, ...] = (
        *(_check_variables, _check_sections, _check_jobs, _check_plugins, _check_with),
        *(_check_sequences, _check_scalars, _check_keys, _check_order),
    )
    found = [finding for rule in rules for finding in rule(root)]
    return CheckResult(source, sort_findings(found))


def _refusal(node: YamlNode, message: str, *, key: bool = False) -> Finding:
    return make_finding(node, f"Rigel 0.3 refuses {message}", KIND, key=key)


def _difference(node: YamlNode, message: str, *, key: bool = False) -> Finding:
    finding = make_finding(node, f"Rigel 0.3 {message}", KIND, key=key)
    return attrs.evolve(finding, severity="warning")


def _section(root: YamlNode, name: str) -> dict[str, YamlNode]:
    section = root.value.get(name)
    return section.value if section and isinstance(section.value, dict) else {}


# What its models refuse


def _check_variables(root: YamlNode) -> Iterator[Finding]:
    for node in _section(root, "vars").values():
        fits = isinstance(node.value, dict) and set(node.value) == {"type", "with"}
        if node.value is None or (isinstance(node.value, dict | list) and not fits):
            yield _refusal(node, f"{kind_of(node.value)} as a var: only single values")


def _check_sections(root: YamlNode) -> Iterator[Finding]:
    for name in ("vars", "jobs", "providers", "sequences"):
        node = root.value.get(name)
        if node is not None and node.value is None:
            yield _refusal(node, f"`{name}` without content: remove the key", key=True)


def _check_jobs(root: YamlNode) -> Iterator[Finding]:
    if "jobs" not in root.value:
        yield _refusal(root, "a file without `jobs`")


def _check_plugins(root: YamlNode) -> Iterator[Finding]:
    for section, key in (("jobs", "plugin"), ("providers", "provider")):
        for node in _section(root, section).values():
            name = node.value.get(key) if isinstance(node.value, dict) else None
            if name and isinstance(name.value, str) and "." not in name.value:
                yield _refusal(name, "short names: write package.module.Class")


def _check_with(root: YamlNode) -> Iterator[Finding]:
    for section in ("jobs", "providers"):
        for node in _section(root, section).values():
            if isinstance(node.value, dict) and "with" not in node.value:
                yield _refusal(node, "an entry without `with`: add `with: {}`", key=True)
    for use in _uses(root):
        if isinstance(use.value, dict) and "with" not in use.value:
            yield _refusal(use, "a job's entry without `with`: write the name alone")


def _uses(root: YamlNode) -> Iterator[YamlNode]:
    for sequence in _section(root, "sequences").values():
        for stage in _list(sequence, "stages"):
            for inner in (stage, *_list(stage, "parallel")):
                yield from _list(inner, "jobs")
                yield from _list(inner, "dependencies")


def _list(node: YamlNode, key: str) -> list[YamlNode]:
    child = node.value.get(key) if isinstance(node.value, dict) else None
    return child.value if child and isinstance(child.value, list) else []


def _check_sequences(root: YamlNode) -> Iterator[Finding]:
    for sequence in _section(root, "sequences").values():
        if not isinstance(sequence.value, dict):
            continue
        description, matrix = sequence.value.get("description"), sequence.value.get("matrix")
        if description:
            yield _refusal(
                description, "a `description` of a sequence: stages may have one", key=True
            )
        if matrix:
            yield _difference(
                matrix, "ignores the matrix of a sequence: give it to a stage", key=True
            )
        for stage in _list(sequence, "stages"):
            yield from _check_waves(stage)


def _check_waves(stage: YamlNode) -> Iterator[Finding]:
    matrix = stage.value.get("matrix") if isinstance(stage.value, dict) else None
    if matrix and isinstance(matrix.value, dict):
        for name in filter(matrix.value.__contains__, LIMITS):
            message = f"runs all branches at once: to it `{name}` is one more list of values"
            yield _difference(matrix.value[name], message, key=True)


# What it reads differently


def _check_scalars(root: YamlNode) -> Iterator[Finding]:
    for node in _leaves(root):
        if isinstance(node.value, str) and has_template(node.value):
            yield from _templates(node, node.value, key=False)
        elif isinstance(node.value, float) and str(node.value) != node.raw:
            yield _difference(node, f"reads {node.raw} as {node.value}: quote it if it is text")
    yield from _check_texts(root)


def _check_keys(root: YamlNode) -> Iterator[Finding]:
    for key, node in _list_entries(root):
        if not has_template(key):
            continue
        yield from _templates(node, key, key=True)
        if len(list(parts(key))) > 1:
            yield _difference(node, "puts the var in place of the whole key", key=True)


def _templates(node: YamlNode, text: str, *, key: bool) -> Iterator[Finding]:
    for part in parts(text):
        if isinstance(part, Expression):
            if _NAME.fullmatch(part.text):
                yield _refusal(node, f"{part.text}: it looks for a var of that name", key=key)
            else:
                yield _difference(node, f"leaves {part.text} as it is", key=key)


def _check_texts(root: YamlNode) -> Iterator[Finding]:
    """Yield vars inside a text whose value Rigel would write as Python does."""
    variables = _section(root, "vars")
    for node in _leaves(root):
        pieces = list(parts(node.value)) if isinstance(node.value, str) else []
        if len(pieces) < 2:
            continue
        for part in pieces:
            used = variables.get(part.name) if isinstance(part, Name) else None
            if used and isinstance(used.value, bool | float) and str(used.value) != used.raw:
                yield _difference(node, f"writes {used.value} for {used.raw}: quote it in `vars`")


def _check_order(root: YamlNode) -> Iterator[Finding]:
    """Yield vars that use a later one that is a template: Rigel renders `vars` once, in order."""
    variables = _section(root, "vars")
    seen: set[str] = set()
    for name, node in variables.items():
        for part in parts(node.value) if isinstance(node.value, str) else ():
            if not isinstance(part, Name) or part.name not in variables.keys() - seen:
                continue
            if has_template(str(variables[part.name].value)):
                yield _difference(
                    node, f"may not fill vars.{part.name}: put that above vars.{name}"
                )
        seen.add(name)


def _leaves(node: YamlNode) -> Iterator[YamlNode]:
    if isinstance(node.value, dict | list):
        for child in node.children():
            yield from _leaves(child)
    else:
        yield node


def _list_entries(node: YamlNode) -> Iterator[tuple[str, YamlNode]]:
    if isinstance(node.value, dict):
        yield from node.value.items()
    for child in node.children():
        yield from _list_entries(child)

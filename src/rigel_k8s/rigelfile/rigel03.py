"""What Rigel 0.3 would refuse in a Rigelfile (errors), or read otherwise (warnings).

What both refuse is not told here: that is for check_file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import attrs

from rigel_k8s.option_text import has_template
from rigel_k8s.rigelfile.check import CheckResult, open_source
from rigel_k8s.rigelfile.findings import Finding, at, in_order
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import YamlNode, kind_of
from rigel_k8s.rigelfile.template import Expression, Name, parts

KIND = "rigel03"
#: What Rigel 0.3 takes for a name: it squeezes the blanks out and looks the rest up.
_NAME = re.compile(r"\{\{[a-zA-Z0-9_\s\-!?.]+\}\}")

Rule = Callable[[YamlNode], Iterator[Finding]]


def rigel03(path: Path, environ: Mapping[str, str] = os.environ) -> CheckResult:
    """Return what Rigel 0.3 makes of a file that passes a check.

    Raises:
        UserError: it cannot be read.
    """
    source = open_source(path)
    root, _ = parse(source)
    if root is None or not isinstance(root.value, dict):
        return CheckResult(source, ())
    rules: tuple[Rule, ...] = (
        *(_variables, _empty_sections, _jobs, _plugins, _without_with),
        *(_sequences, _scalars, _keys, _order),
    )
    found = [finding for rule in rules for finding in rule(root)]
    return CheckResult(source, in_order(found))


def _refused(node: YamlNode, message: str, *, key: bool = False) -> Finding:
    return at(node, f"Rigel 0.3 refuses {message}", KIND, key=key)


def _otherwise(node: YamlNode, message: str, *, key: bool = False) -> Finding:
    finding = at(node, f"Rigel 0.3 {message}", KIND, key=key)
    return attrs.evolve(finding, severity="warning")


def _section(root: YamlNode, name: str) -> dict[str, YamlNode]:
    section = root.value.get(name)
    return section.value if section and isinstance(section.value, dict) else {}


# What its models refuse


def _variables(root: YamlNode) -> Iterator[Finding]:
    for node in _section(root, "vars").values():
        fits = isinstance(node.value, dict) and set(node.value) == {"type", "with"}
        if node.value is None or (isinstance(node.value, dict | list) and not fits):
            yield _refused(node, f"{kind_of(node.value)} as a var: only single values")


def _empty_sections(root: YamlNode) -> Iterator[Finding]:
    for name in ("vars", "jobs", "providers", "sequences"):
        node = root.value.get(name)
        if node is not None and node.value is None:
            yield _refused(node, f"`{name}` without content: remove the key", key=True)


def _jobs(root: YamlNode) -> Iterator[Finding]:
    if "jobs" not in root.value:
        yield _refused(root, "a file without `jobs`")


def _plugins(root: YamlNode) -> Iterator[Finding]:
    for section, key in (("jobs", "plugin"), ("providers", "provider")):
        for node in _section(root, section).values():
            name = node.value.get(key) if isinstance(node.value, dict) else None
            if name and isinstance(name.value, str) and "." not in name.value:
                yield _refused(name, "short names: write package.module.Class")


def _without_with(root: YamlNode) -> Iterator[Finding]:
    for section in ("jobs", "providers"):
        for node in _section(root, section).values():
            if isinstance(node.value, dict) and "with" not in node.value:
                yield _refused(node, "an entry without `with`: add `with: {}`", key=True)
    for use in _uses(root):
        if isinstance(use.value, dict) and "with" not in use.value:
            yield _refused(use, "a job's entry without `with`: write the name alone")


def _uses(root: YamlNode) -> Iterator[YamlNode]:
    for sequence in _section(root, "sequences").values():
        for stage in _list(sequence, "stages"):
            for inner in (stage, *_list(stage, "parallel")):
                yield from _list(inner, "jobs")
                yield from _list(inner, "dependencies")


def _list(node: YamlNode, key: str) -> list[YamlNode]:
    child = node.value.get(key) if isinstance(node.value, dict) else None
    return child.value if child and isinstance(child.value, list) else []


def _sequences(root: YamlNode) -> Iterator[Finding]:
    for sequence in _section(root, "sequences").values():
        if not isinstance(sequence.value, dict):
            continue
        description, matrix = sequence.value.get("description"), sequence.value.get("matrix")
        if description:
            yield _refused(
                description, "a `description` of a sequence: stages may have one", key=True
            )
        if matrix:
            yield _otherwise(
                matrix, "ignores the matrix of a sequence: give it to a stage", key=True
            )


# What it reads otherwise


def _scalars(root: YamlNode) -> Iterator[Finding]:
    for node in _leaves(root):
        if isinstance(node.value, str) and has_template(node.value):
            yield from _templates(node, node.value, key=False)
        elif isinstance(node.value, float) and str(node.value) != node.raw:
            yield _otherwise(node, f"reads {node.raw} as {node.value}: quote it if it is text")
    yield from _in_texts(root)


def _keys(root: YamlNode) -> Iterator[Finding]:
    for key, node in _keyed(root):
        if not has_template(key):
            continue
        yield from _templates(node, key, key=True)
        if len(list(parts(key))) > 1:
            yield _otherwise(node, "puts the var in place of the whole key", key=True)


def _templates(node: YamlNode, text: str, *, key: bool) -> Iterator[Finding]:
    for part in parts(text):
        if isinstance(part, Expression):
            if _NAME.fullmatch(part.text):
                yield _refused(node, f"{part.text}: it looks for a var of that name", key=key)
            else:
                yield _otherwise(node, f"leaves {part.text} as it is", key=key)


def _in_texts(root: YamlNode) -> Iterator[Finding]:
    """Yield vars inside a text that Rigel would write as Python does."""
    variables = _section(root, "vars")
    for node in _leaves(root):
        pieces = list(parts(node.value)) if isinstance(node.value, str) else []
        if len(pieces) < 2:
            continue
        for part in pieces:
            used = variables.get(part.name) if isinstance(part, Name) else None
            if used and isinstance(used.value, bool | float) and str(used.value) != used.raw:
                yield _otherwise(node, f"writes {used.value} for {used.raw}: quote it in `vars`")


def _order(root: YamlNode) -> Iterator[Finding]:
    """Yield vars that use one below them that is a template itself: Rigel goes down only once."""
    variables = _section(root, "vars")
    seen: set[str] = set()
    for name, node in variables.items():
        for part in parts(node.value) if isinstance(node.value, str) else ():
            if not isinstance(part, Name) or part.name not in variables.keys() - seen:
                continue
            if has_template(str(variables[part.name].value)):
                yield _otherwise(node, f"may not fill vars.{part.name}: put that above vars.{name}")
        seen.add(name)


def _leaves(node: YamlNode) -> Iterator[YamlNode]:
    if isinstance(node.value, dict | list):
        for child in node.children():
            yield from _leaves(child)
    else:
        yield node


def _keyed(node: YamlNode) -> Iterator[tuple[str, YamlNode]]:
    if isinstance(node.value, dict):
        yield from node.value.items()
    for child in node.children():
        yield from _keyed(child)

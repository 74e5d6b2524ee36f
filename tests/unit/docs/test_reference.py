"""The generated pages are what the code says, and the code explains all that it reports."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from rigel_exporter.metrics import FAMILIES, LABELS
from rigel_k8s import errors, signals
from tools.reference import PAGES
from tools.reference.alerts import list_rules
from tools.reference.kinds import EXIT_CODES
from tools.reference.meanings import CONDITIONS, SERIES

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"


@pytest.mark.parametrize("name", sorted(PAGES))
def test_a_page_is_current(name: str, update_golden: bool) -> None:  # noqa: FBT001 - a fixture
    """`python -m tools.reference` writes them all, and so does --update-golden."""
    text = PAGES[name]()
    if update_golden:
        (DOCS / name).write_text(text, "utf-8")
    assert (DOCS / name).read_text("utf-8") == text


def test_exit_codes_are_those_of_the_errors() -> None:
    """And of the two signals."""
    classes = [kind for kind in vars(errors).values() if isinstance(kind, type)]
    codes = {kind.exit_code for kind in classes if issubclass(kind, errors.RigelK8sError)}
    assert codes | {0, *(128 + number for number in signals.NUMBERS)} == set(EXIT_CODES)


def test_metrics_have_the_labels_of_their_samples() -> None:
    """Read from the code that makes the samples."""
    found = {}
    for path in (ROOT / "src/rigel_exporter").glob("*.py"):
        for function in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(function, ast.FunctionDef):
                found.update(find_samples(function))
    assert set(found) == set(FAMILIES)
    assert {name: labels for name, labels in found.items() if labels} == LABELS


def find_samples(function: ast.FunctionDef) -> dict[str, tuple[str, ...]]:
    """Return the labels of a function's samples; a variable counts up to its next assignment."""
    labels: dict[str, tuple[str, ...]] = {}
    found: dict[str, tuple[str, ...]] = {}
    nodes = [node for node in ast.walk(function) if isinstance(node, ast.Assign | ast.Call)]
    for node in sorted(nodes, key=lambda node: (node.lineno, node.col_offset)):
        if isinstance(node, ast.Assign):
            targets, values = node.targets[0], node.value
            pairs = (
                zip(targets.elts, values.elts, strict=True)
                if isinstance(targets, ast.Tuple) and isinstance(values, ast.Tuple)
                else [(targets, values)]
            )
            for target, value in pairs:
                if isinstance(value, ast.Dict):
                    labels[ast.unparse(target)] = read_keys(value)
        elif ast.unparse(node.func) == "Sample" and isinstance(node.args[0], ast.Constant):
            given = node.args[2] if len(node.args) > 2 else ast.Dict([], [])
            name = str(node.args[0].value)
            found[name] = (
                read_keys(given) if isinstance(given, ast.Dict) else labels[ast.unparse(given)]
            )
    return found


def read_keys(value: ast.Dict) -> tuple[str, ...]:
    """Return the keys of a dictionary that is written out."""
    return tuple(str(key.value) for key in value.keys if isinstance(key, ast.Constant))


def test_rules_are_explained() -> None:
    """Each recorded series with its labels, each alert with its condition."""
    rules = list(list_rules())
    assert {rule["alert"] for rule in rules if "alert" in rule} == set(CONDITIONS)
    recorded = {rule["record"]: rule["expr"] for rule in rules if "record" in rule}
    assert set(recorded) == set(SERIES)
    for name, series in SERIES.items():
        by = re.search(r"\b(?:by|on) \(([^)]*)\)", recorded[name])
        assert by is not None, name
        assert tuple(by[1].split(", ")) == series.labels, name


def test_runbooks_have_their_alert_s_severity_and_time() -> None:
    """In the first line of each, and in the list of all."""
    listed = (DOCS / "runbooks" / "README.md").read_text("utf-8")
    for rule in list_rules():
        if "alert" in rule:
            name, severity = rule["alert"], rule["labels"]["severity"]
            minutes = int(rule["for"].removesuffix("m"))
            text = (DOCS / "runbooks" / f"{name}.md").read_text("utf-8")
            line = text.splitlines()[2]
            assert line.startswith(f"Severity {severity}; "), name
            assert f" {minutes} minute" in line, name
            assert f"| [{name}]({name}.md) | {severity} |" in listed, name

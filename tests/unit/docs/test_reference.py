"""The generated pages are what the code says, and the code explains all that it reports."""

from __future__ import annotations

import ast
import re
import shutil
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

import pytest

from rigel_exporter.metrics import FAMILIES, LABELS
from rigel_k8s import errors, signals
from rigel_k8s.discovery.kinds import GRAPH
from rigel_k8s.kinds import EXIT_CODES, PODS, PROBLEMS, Kind
from rigel_k8s.kube.failures import Ground
from rigel_k8s.network.preflight.kinds import PREFLIGHT
from rigel_k8s.observability.boards.meanings import CONDITIONS, SERIES
from rigel_k8s.release.rollout.kinds import CAUSES
from rigel_k8s.rosgraph.kinds import ROS_GRAPH
from rigel_muto.agent.kinds import REFUSALS
from tests.support.kinds import SOURCES, Unseen, Use, find_kinds
from tools.reference import PAGES
from tools.reference.alerts import list_rules

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
#: What a deploy's checks and a Rigelfile's share: one name in two tables.
TABLES: Mapping[str, Mapping[str, Kind]] = {
    "problem": {name: kind for group in PROBLEMS.values() for name, kind in group.items()},
    "preflight": {name: kind for group in PREFLIGHT.values() for name, kind in group.items()},
    "graph": GRAPH,
    "rosgraph": ROS_GRAPH,
    "cause": CAUSES,
    "refusal": REFUSALS,
}
#: Kinds without a remedy: nothing is wrong.
FINE = {"0", "left-out"}
#: Kinds of the tests' own job types.
OF_TESTS = {"bad-limits", "bad-size", "bad-wheel", "many"}


@pytest.fixture(scope="module")
def uses() -> list[Use]:
    """Every kind in the code."""
    return find_kinds()


@pytest.mark.parametrize("name", sorted(PAGES))
def test_a_page_is_current(name: str, update_golden: bool) -> None:  # noqa: FBT001 - a fixture
    """`python -m tools.reference` writes them all, and so does --update-golden."""
    text = PAGES[name]()
    if update_golden:
        (DOCS / name).write_text(text, "utf-8")
    assert (DOCS / name).read_text("utf-8") == text


@pytest.mark.parametrize("family", sorted(TABLES))
def test_each_kind_is_explained_and_each_explanation_has_its_kind(
    family: str, uses: list[Use]
) -> None:
    """A new kind gets its cause and its remedy in the table beside it."""
    found = {use.kind for use in uses if use.family == family}
    if family == "problem":  # what a 403 is about is the kind of the problem that comes of it
        found |= set(get_args(Ground)) - {"other"}
    assert found == set(TABLES[family])


def test_the_kinds_that_tests_show_are_explained() -> None:
    """Each `[kind]` at the end of an expected output: a second look, at what is really printed."""
    outputs = [*ROOT.glob("tests/unit/*/err/*.out"), *ROOT.glob("tests/unit/muto/**/*.out")]
    shown = {
        kind
        for path in outputs
        for kind in re.findall(r"^\S+: .* \[([a-z0-9-]+)\]$", path.read_text("utf-8"), re.M)
    }
    assert len(shown) > 30
    assert shown - set(TABLES["problem"]) <= OF_TESTS


def test_explanations_are_complete() -> None:
    """A cause, a remedy where there is something to do, and no period."""
    kinds = [*TABLES.values(), PODS, {str(code): kind for code, kind in EXIT_CODES.items()}]
    for table in kinds:
        for name, kind in table.items():
            assert kind.cause, name
            assert bool(kind.remedy) != (name in FINE), name
            for text in (kind.cause, kind.remedy):
                assert not text.endswith("."), name


def test_exit_codes_are_those_of_the_errors() -> None:
    """And of the two signals."""
    classes = [kind for kind in vars(errors).values() if isinstance(kind, type)]
    codes = {kind.exit_code for kind in classes if issubclass(kind, errors.RigelK8sError)}
    assert codes | {0, *(128 + number for number in signals.NUMBERS)} == set(EXIT_CODES)


def test_the_preflight_s_table_has_what_the_code_does(uses: list[Use]) -> None:
    """Which findings are warnings, and whose fault the others are."""
    found = defaultdict(set)
    for use in uses:
        if use.call is not None and ast.unparse(use.call.func) == "PreflightFinding":
            given = {one.arg: ast.unparse(one.value) for one in use.call.keywords}
            changes = "Rigelfile" if given.get("fault") == "'rigelfile'" else "cluster"
            found[use.kind].add("warning" if given.get("severity") == "'warning'" else changes)
    assert len(found) > 20
    for group in PREFLIGHT.values():
        for name, kind in group.items():
            assert kind.changes in found.get(name, {kind.changes}), name


def test_metrics_have_the_labels_of_their_samples() -> None:
    """Read from the code that makes the samples."""
    found = {}
    for path in (SOURCES / "rigel_exporter").glob("*.py"):
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


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """A copy of two modules, for a test to spoil."""
    for name in ("network/checks.py", "network/preflight/limits.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(SOURCES / name, tmp_path / name)
    return tmp_path


def test_a_new_kind_is_found(sources: Path) -> None:
    """As an argument, with its name, and as one of two."""
    with (sources / "rigel_k8s" / "network" / "checks.py").open("a") as module:
        module.write(
            'def spoil(x, /):\n    slug = "one" if x else "two"\n'
            '    yield Problem((), "", slug)\n    yield Problem((), "", kind="three")\n'
        )
    kinds = {use.kind for use in find_kinds(sources)}
    assert kinds - set(TABLES["problem"]) - set(TABLES["preflight"]) == {"one", "two", "three"}


@pytest.mark.parametrize("argument", ['f"no-{x}"', "x", "pick(x)"])
def test_a_kind_that_cannot_be_read_is_refused(sources: Path, argument: str) -> None:
    """A computed one, and one that a function which is no maker passes on."""
    with (sources / "rigel_k8s" / "network" / "checks.py").open("a") as module:
        module.write(f'def spoil(x):\n    yield Problem((), "", {argument})\n')
    with pytest.raises(Unseen):
        find_kinds(sources)


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

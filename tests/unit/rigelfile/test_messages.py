"""Every message has a bad file in err/, and beside it what is found; what is in ok/ is clean.

`pytest tests/unit/rigelfile --update-golden` writes what is found.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.jobs import registry
from rigel_k8s.rigelfile import (
    CheckResult,
    Finding,
    Source,
    Span,
    check_file,
    find_nearest,
    render,
)

HERE = Path(__file__).parent
#: Whose output is as it is printed; that of the others has a line for each finding.
PRINTED = ("eight-kinds", "tab", "control-character")
ENVIRON = {"REGISTRY": "localhost:5000", "WORD": "ten", "BASE_IMAGE": "ros:noetic"}


def files(folder: str) -> list[Any]:
    found = sorted((HERE / folder).glob("*.Rigelfile"))
    assert found
    return [pytest.param(file, id=file.stem) for file in found]


def shorten(finding: str) -> str:
    """Return a printed finding on a line: what a caret marks stands behind the message."""
    message, *lines = finding.split("\n")
    marked = [
        text[caret.index("^") : len(caret)]
        for text, caret in zip(lines[::2], lines[1::2], strict=True)
    ]
    return "  ".join([message, *(f"<{text}>" for text in marked)])


def compare(result: CheckResult, golden: Path, *, update: bool) -> None:
    findings = result.render_findings()
    text = "\n".join([*(findings if golden.stem in PRINTED else map(shorten, findings)), ""])
    if update:
        golden.write_text(text)
    assert text == golden.read_text()


def real(kind: str, name: str) -> Any:
    """Resolve this package's own job types and providers."""
    return registry.job_type(name) if kind == "job" else registry.provider_type(name)


@pytest.fixture
def resolver(resolve: Callable[[str, str], Any]) -> Callable[[str, str], Any]:
    """What finds the tests' own types by their names, and this package's by theirs."""
    return lambda kind, name: (real if name.startswith("rigel_k8s.") else resolve)(kind, name)


@pytest.mark.parametrize("file", files("err"))
def test_a_bad_file_is_told_with_places(
    file: Path,
    resolver: Callable[[str, str], Any],
    update_golden: bool,  # noqa: FBT001 - a fixture
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All problems of a file are told at once, each with its line and a caret."""
    monkeypatch.chdir(file.parent)
    result = check_file(Path(file.name), ENVIRON, resolver)
    assert result.findings
    compare(result, file.with_suffix(".out"), update=update_golden)


@pytest.mark.parametrize("file", files("ok"))
def test_a_good_file_is_clean(file: Path, resolver: Callable[[str, str], Any]) -> None:
    """Nothing is told of a file that is right."""
    result = check_file(file, ENVIRON, resolver)
    assert result.render_findings() == []
    assert result.rigelfile is not None


def test_eight_kinds_of_mistake_are_told_at_once(resolver: Callable[[str, str], Any]) -> None:
    """One file has eight kinds of mistake and more, some of them inside substituted lists."""
    result = check_file(HERE / "err" / "eight-kinds.Rigelfile", ENVIRON, resolver)
    assert len({finding.kind for finding in result.findings}) >= 8
    assert sum(1 for finding in result.findings if finding.defined_at) >= 3


@pytest.mark.parametrize("width", [50, 80, 160, 300])
@pytest.mark.parametrize("before", [0, 10, 2500, 4985])
def test_a_long_line_is_cut_around_the_caret(before: int, width: int) -> None:
    """Of a line of 5,000 characters so much is shown as there are columns, with its place."""
    line = "a" * before + "wrong" + "b" * (4995 - before)
    place = Span(1, before + 1, 1, before + 6)
    _, shown, caret = render(
        Source("Rigelfile", line), Finding(place, "this is wrong", "kind"), width=width
    ).split("\n")
    assert len(shown) == width
    marked = slice(caret.index("^"), caret.index("^") + 5)
    assert (shown[marked], caret[marked]) == ("wrong", "^~~~~")
    assert shown.startswith("1 | ...") is (before > width)
    assert shown.endswith("...") is (4995 - before > width)


def test_of_equally_similar_names_the_one_that_begins_alike_is_meant() -> None:
    assert find_nearest("moter", ["other", "motor"]) == "motor"
    assert find_nearest("moter", ["motor", "other"]) == "motor"

"""Every sample has a golden Rigelfile that means the same as the stack; every bad stack its output.

`pytest tests/unit/muto --update-golden` writes both.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rigel_k8s.cli.main import run
from rigel_k8s.ros import CURRENT

from .shapes import FOLDER, SAMPLES

HERE = Path(__file__).parent
#: Bad stacks that are only there for others to refer to.
REFERRED = ("twice-a", "twice-b", "wheel")


def convert(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Return the exit code, standard output and standard error of `rigel muto convert`."""
    code = run(["muto", "convert", *words], "rigel")
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def compare(text: str, golden: Path, *, update: bool) -> None:
    if update:
        golden.write_text(text, "utf-8")
    assert text == golden.read_text("utf-8")


@pytest.mark.parametrize("name", SAMPLES)
def test_a_sample_becomes_its_rigelfile(
    name: str,
    update_golden: bool,  # noqa: FBT001 - a fixture
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is not carried over is printed, with its place, and stands in comments."""
    directory, stack = SAMPLES[name]
    monkeypatch.chdir(FOLDER / directory)
    code, text, warnings = convert(capsys, stack)
    assert code == 0
    compare(text, FOLDER / f"{name}.Rigelfile", update=update_golden)
    compare(warnings, FOLDER / f"{name}.err", update=update_golden)
    assert (code, text, warnings) == convert(capsys, stack)


@pytest.mark.parametrize(
    "file",
    [f for f in sorted((HERE / "err").glob("*.json")) if f.stem not in REFERRED],
    ids=lambda file: file.stem,
)
def test_a_bad_stack_is_reported_with_its_places(
    file: Path,
    update_golden: bool,  # noqa: FBT001 - a fixture
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All that is wrong is reported at once, each with file, line, column and a caret."""
    monkeypatch.chdir(file.parent)
    code, text, errors = convert(capsys, file.name)
    assert (code, text) == (2, "")
    compare(errors, file.with_suffix(".out"), update=update_golden)


def test_chains_have_a_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of arguments that need each other, and of stacks that refer to each other."""
    monkeypatch.chdir(tmp_path)
    arguments = [{"name": f"a{n}", "value": f"$(arg a{n + 1})"} for n in range(2000)]
    node = {"name": "n", "pkg": "p", "exec": "e", "args": "$(arg a0)"}
    Path("arguments.json").write_text(json.dumps({"arg": arguments, "node": [node]}))
    code, _, errors = convert(capsys, "arguments.json")
    assert (code, "more than 50 arguments need each other" in errors) == (2, True)
    stacks = [{"stackId": f"org:{n}", "stack": [{"thingId": f"org:{n + 1}"}]} for n in range(2000)]
    Path("stacks.json").write_text(json.dumps(stacks))
    code, _, errors = convert(capsys, "org:0")
    assert (code, "more than 50 stacks refer to each other" in errors) == (2, True)


TALKER = {"name": "talker", "pkg": "p", "exec": "talker"}


def test_a_reference_that_several_files_have_can_be_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The message has both ways to do that; files with the same content need no choice."""
    monkeypatch.chdir(tmp_path)
    Path("whole.json").write_text(json.dumps({"stack": [{"thingId": "org:base"}]}))
    for file, program in (("a.json", "one"), ("b.json", "two")):
        base = {"stackId": "org:base", "node": [{**TALKER, "exec": program}]}
        Path(file).write_text(json.dumps(base))
    code, _, errors = convert(capsys, "whole.json")
    assert code == 2
    assert "--reference org:base=a.json" in errors
    assert '`references: {"org:base": a.json}`' in errors
    code, text, _ = convert(capsys, "whole.json", "--reference", "org:base=b.json")
    assert (code, "executable: two" in text) == (0, True)
    assert convert(capsys, "whole.json", "--reference", "org:base=whole.json")[0] == 2
    Path("b.json").write_text(Path("a.json").read_text())
    assert convert(capsys, "whole.json")[0] == 0


@pytest.mark.parametrize(
    ("more", "distro"),
    [
        ({}, CURRENT),
        ({"param": [{"name": "a", "value": "1"}]}, "noetic"),
        ({"node": [{**TALKER, "pkg": "nodelet", "exec": "nodelet", "args": "manager"}]}, "noetic"),
        ({"composable": [{"name": "c", "package": "p", "executable": "e", "node": []}]}, CURRENT),
    ],
)
def test_the_ros_of_a_stack_is_that_of_what_is_in_it(
    more: dict[str, object],
    distro: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where nothing in it decides, ROS 2 is assumed, with a warning and a comment."""
    monkeypatch.chdir(tmp_path)
    Path("stack.json").write_text(json.dumps({"node": [TALKER], **more}))
    code, text, warnings = convert(capsys, "stack.json")
    assert (code, f"distro: {distro}" in text) == (0, True)
    assumed = "nothing in this stack says for which ROS it is"
    assert (assumed in text, assumed in warnings) == (not more, not more)
    code, text, warnings = convert(capsys, "stack.json", "--distro", "humble")
    assert ("distro: humble" in text, assumed in warnings) == (True, False)

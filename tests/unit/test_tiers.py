"""The runs of `./run test`: what is repeated, what a run ends with, and what the proof has."""

from __future__ import annotations

import ast
import json
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from .. import tiers
from ..proof import PROOF

ROOT = Path(__file__).parents[2]
CONFTEST = "from tests.conftest import pytest_addoption, pytest_collection_modifyitems\n"
SETTINGS = """[pytest]
markers =
    cluster
    proof
    slow
    timing
    story
pythonpath = {root}
"""
#: Fails the first time, if its file does not exist yet.
ONCE = """
    there = pathlib.Path(f"{name}.ran").exists()
    pathlib.Path(f"{name}.ran").touch()
    assert there
"""
HEAD = "import pathlib, pytest\npytestmark = [pytest.mark.cluster{more}]\n"


def run(
    directory: Path,
    monkeypatch: pytest.MonkeyPatch,
    tests: dict[str, str],
    *,
    more: str = "",
    repeats: bool = True,
) -> int:
    """Run a tier of one phase in a directory with these tests: name -> body."""
    directory.joinpath("conftest.py").write_text(CONFTEST)
    directory.joinpath("pytest.ini").write_text(SETTINGS.format(root=ROOT))
    bodies = [f"def test_{name}():\n{body}\n" for name, body in tests.items()]
    text = HEAD.format(more=more) + "".join(bodies)
    directory.joinpath("test_some.py").write_text(text)
    monkeypatch.chdir(directory)
    monkeypatch.setenv("RIGEL_TEST_CONTEXT", "a-cluster-that-is-there")
    phase = tiers.Phase("some", "Some", "cluster", 0, repeats=repeats)
    monkeypatch.setattr(tiers, "TIERS", {"": (phase,)})
    return tiers.main([])


@pytest.mark.programs
def test_what_passes_the_second_time_is_unsteady(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The run passes, its last lines name the test, and the JUnit file has its failure."""
    once = ONCE.format(name="once")
    assert run(tmp_path, monkeypatch, {"fine": "    pass", "once": once}) == 0
    last = capfd.readouterr().out.splitlines()[-2:]
    assert last == ["unsteady: 1 (test_some.py::test_once)", "2 passed, 0 failed, 0 skipped"]
    case = ET.parse(tmp_path / ".test-results/junit.xml").find(".//testcase[@name='test_once']")
    assert case is not None
    assert [child.tag for child in case] == ["flakyFailure"]
    kept = json.loads((tmp_path / ".test-results/run.json").read_text())
    assert kept["unsteady"] == ["test_some.py::test_once"]
    assert list(kept["minutes"]) == ["some", "again"]


@pytest.mark.programs
def test_what_fails_twice_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Beside one that is unsteady."""
    tests = {"bad": "    assert False", "once": ONCE.format(name="once")}
    assert run(tmp_path, monkeypatch, tests) == 1
    last = capfd.readouterr().out.splitlines()[-3:]
    assert last[1:] == ["failed: test_some.py::test_bad", "1 passed, 1 failed, 0 skipped"]


@pytest.mark.programs
def test_a_unit_test_is_never_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It depends on nothing that could be different the second time."""
    tests = {"once": ONCE.format(name="once")}
    assert run(tmp_path, monkeypatch, tests, repeats=False) == 1


@pytest.mark.programs
def test_a_run_that_does_not_end_well_is_never_unsteady(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A test file that cannot be read has no test that could pass later."""
    assert run(tmp_path, monkeypatch, {"fine": "    pass"}, more=", no_such_name") == 1


@pytest.mark.programs
def test_a_story_is_repeated_from_its_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a test goes on from is done again; what comes after it is not."""
    count = "    with open('{name}', 'a') as file: file.write('x')\n"
    once = ONCE.format(name="once")
    tests = {"a": count.format(name="a"), "b": once, "c": count.format(name="c")}
    assert run(tmp_path, monkeypatch, tests, more=", pytest.mark.story") == 0
    assert [tmp_path.joinpath(name).read_text() for name in "ac"] == ["xx", "x"]


@pytest.mark.parametrize("room", [0, 1])
def test_temporary_files_are_in_memory_where_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    """And nothing of them stays there."""
    monkeypatch.setattr(tiers, "MEMORY", Path("/"))
    monkeypatch.setattr(tiers, "ENOUGH", 2**80 * (1 - room))
    monkeypatch.setattr(tiers, "make_directory", lambda: tempfile.mkdtemp(dir=tmp_path))
    with tiers.temporary_files(in_memory=True) as environ:
        Path(environ.get("TMPDIR", tmp_path), "some").touch()
        assert len(list(tmp_path.glob("*/some"))) == room
    assert not list(tmp_path.glob("*/some"))


def test_the_proof_is_neither_empty_nor_long() -> None:
    """The table in the documentation is read."""
    assert 40 <= len(PROOF) <= 60


@pytest.mark.parametrize("nodeid", PROOF)
def test_each_test_of_the_proof_is_there(nodeid: str) -> None:
    """A test that was renamed takes its place in the proof along, and none of them is rare."""
    file, *names = nodeid.split("::")
    body = ast.parse((ROOT / file).read_text()).body
    for name in names:
        [found] = (
            part
            for part in body
            if isinstance(part, ast.FunctionDef | ast.ClassDef) and part.name == name
        )
        rare = {"slow", "timing"} & {getattr(one, "attr", "") for one in found.decorator_list}
        assert not rare
        body = found.body

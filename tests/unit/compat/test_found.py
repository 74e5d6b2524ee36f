"""Which job a plugin inside Rigel is, from Rigel's command line and the data it was given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.compat.found import CommandLine, command_line, find_use
from rigel_k8s.errors import UserError
from rigel_k8s.jobs.names import list_installed
from rigel_k8s.rigelfile import Rigelfile, load, strip_places

[BUILTIN] = [one for one in list_installed("job") if one.short == "dockerfile"]

TEXT = """
vars: {v: "1.10", list: [a, b]}
application: {distro: noetic}
jobs:
  filtered: {plugin: rigel_k8s.DockerfilePlugin, with: {x: "{{ vars.v | upper }}", only: 1}}
  number: {plugin: rigel_k8s.DockerfilePlugin, with: {x: "{{ vars.v }}", y: "{{ vars.list }}"}}
  data: {plugin: rigel.plugins.core.DockerfilePlugin, with: {x: "{{ data.d }}", d: true}}
  other: {plugin: rigel_k8s.BuildXPlugin, with: {x: 1}}
sequences:
  s: {stages: [{jobs: [{name: number, with: {y: [c]}}]}]}
"""


@pytest.fixture
def rigelfile(tmp_path: Path) -> Rigelfile:
    path = tmp_path / "Rigelfile"
    path.write_text(TEXT)
    return load(path)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("rigel run job deploy", CommandLine("deploy", None)),
        ("rigel run sequence demo", CommandLine(None, "demo")),
        ("rigel run job deploy -f a/R", CommandLine("deploy", None, Path("a/R"))),
        ("rigel run job deploy -fa/R", CommandLine("deploy", None, Path("a/R"))),
        ("rigel run job --file a/R deploy", CommandLine("deploy", None, Path("a/R"))),
        ("rigel run sequence --file=a/R demo", CommandLine(None, "demo", Path("a/R"))),
        ("pytest -x tests", CommandLine()),
        ("rigel", CommandLine()),
    ],
)
def test_rigels_command_line_is_understood(words: str, line: CommandLine) -> None:
    """The job's or sequence's name and the file; another program's says neither."""
    assert command_line(words.split()) == line


@pytest.mark.parametrize(
    ("given", "data", "line", "name"),
    [
        ({"x": "{{ vars.v | upper }}", "only": 1}, {}, CommandLine(), "filtered"),
        ({"x": 1.1, "y": ["a", "b"]}, {}, CommandLine(), "number"),
        ({"x": "7", "d": True}, {"d": 7}, CommandLine(), "data"),
        ({"x": "1.10", "y": ["c"]}, {}, CommandLine(), "number"),
        ({"nothing": "alike"}, {}, CommandLine(job="number"), "number"),
    ],
)
def test_a_job_is_known_by_its_data(
    rigelfile: Rigelfile, given: dict[str, Any], data: dict[str, Any], line: CommandLine, name: str
) -> None:
    """Filters that Rigel left, numbers that it made of text, data, overrides; or by the command."""
    assert find_use(rigelfile, BUILTIN, dict, given, data, line).name == name


def test_the_overrides_of_the_place_of_use_are_found_too(rigelfile: Rigelfile) -> None:
    """The job is run with the sequence's `with`, not with its own."""
    given = {"x": "1.10", "y": ["c"]}
    use = find_use(rigelfile, BUILTIN, dict, given, {}, CommandLine(sequence="s"))
    assert use.overrides is not None
    assert strip_places(use.overrides) == {"y": ["c"]}


def test_a_plugin_that_is_no_job_of_the_file_is_told(rigelfile: Rigelfile) -> None:
    """No guess among several: the jobs are named, and the way out."""
    with pytest.raises(UserError, match="filtered, number, data") as caught:
        find_use(rigelfile, BUILTIN, dict, {"z": 1}, {}, CommandLine())
    assert "rigel-k8s run" in str(caught.value.hint)

"""A file becomes the model, or an error that tells all that is wrong with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from rigel_k8s.errors import ProblemsError, UserError
from rigel_k8s.rigelfile import Rigelfile, load, strip_places
from rigel_k8s.rigelfile.model import Concurrent, JobUse, Parallel, Sequential

Loader = Callable[..., Rigelfile]


def test_the_whole_grammar(loaded: Loader, tmp_path: Path) -> None:
    """Sequential, concurrent and parallel stages, matrices and overrides are in the model."""
    rigelfile = loaded(
        """
jobs: {a: {plugin: p.A}, b: {plugin: p.B, with: {x: 1}}}
providers: {p: {provider: q.P, with: {y: 2}}}
sequences:
  demo:
    description: all
    matrix: {m: [1]}
    stages:
      - jobs: [a, {name: b, with: {x: 2}}]
      - {jobs: [a], dependencies: [b], description: two}
      - parallel: [{jobs: [a]}, {jobs: [a], dependencies: [b]}]
        matrix: {n: [1, 2]}
"""
    )
    assert rigelfile.application.dir == tmp_path
    assert rigelfile.jobs["a"].plugin == "p.A"
    assert strip_places(rigelfile.jobs["a"].options) == {}
    assert rigelfile.jobs["b"].path == ("jobs", "b")
    assert strip_places(rigelfile.providers["p"].options) == {"y": 2}
    demo = rigelfile.sequences["demo"]
    assert demo.matrix is not None
    assert strip_places(demo.matrix) == {"m": [1]}
    first, second, third = demo.stages
    assert isinstance(first, Sequential)
    assert isinstance(second, Concurrent)
    assert isinstance(third, Parallel)
    assert first.jobs[0] == JobUse("a")
    assert first.jobs[1].overrides is not None
    assert strip_places(first.jobs[1].overrides) == {"x": 2}
    assert [use.name for use in second.dependencies] == ["b"]
    assert second.description == "two"
    assert isinstance(third.stages[1], Concurrent)
    assert third.stages[0].jobs == (JobUse("a"),)


def test_merged_mappings(loaded: Loader) -> None:
    """A mapping's own keys win over merged ones, and of several merged mappings the first."""
    rigelfile = loaded(
        "vars: {a: &a {x: 1, y: 1}, b: &b {y: 2, z: 2},"
        " c: {<<: [*a, *b], x: 3}, d: {x: 4, <<: *a}}\n"
    )
    assert rigelfile.vars["c"] == {"x": 3, "y": 1, "z": 2}
    assert rigelfile.vars["d"] == {"x": 4, "y": 1}


def test_directories_are_relative_to_the_file(tmp_path: Path) -> None:
    """application.dir stands beside the Rigelfile, wherever the command is run."""
    file = tmp_path / "Rigelfile"
    file.write_text("application: {distro: noetic, dir: src}\n")
    assert load(file, {}).application.dir == tmp_path / "src"


def test_load_tells_all_problems(loaded: Loader) -> None:
    """The error counts them and has each with its line, and the exit code for what users wrote."""
    with pytest.raises(ProblemsError, match="has 3 problems") as caught:
        loaded(
            "vars: {a: '{{ vars.b }}'}\njobs: {a: {}}\nsequences: {s: {stages: [{jobs: [x]}]}}\n"
        )
    assert caught.value.exit_code == 2
    assert [detail.splitlines()[0].rsplit("[")[-1] for detail in caught.value.details] == [
        "unknown-variable]",
        "missing-key]",
        "unknown-job]",
    ]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """A file that is missing, a directory or not UTF-8 is the user's error, with what to do."""
    with pytest.raises(UserError, match="does not exist") as caught:
        load(tmp_path / "Rigelfile", {})
    assert "rigel init" in (caught.value.hint or "")
    with pytest.raises(UserError, match="directory"):
        load(tmp_path, {})
    (tmp_path / "latin").write_bytes(b"application: \xe9\n")
    with pytest.raises(UserError, match="not UTF-8: byte 13 is 0xe9"):
        load(tmp_path / "latin", {})


@pytest.mark.parametrize("text", ["- " * 5000 + "a", "a: " + "[" * 100_000, "{" * 100_000])
def test_deep_nesting_is_refused(tmp_path: Path, text: str) -> None:
    """The C reader would end the process."""
    (tmp_path / "Rigelfile").write_text(text)
    with pytest.raises(ProblemsError, match="1 problem"):
        load(tmp_path / "Rigelfile", {})


def test_tuples_are_lists(loaded: Loader) -> None:
    """Rigel 0.3 loads them, and the volumes of its ComposePlugin are written with them."""
    text = "jobs: {a: {plugin: p.A, with: {v: [!!python/tuple [/a, /b], !!python/tuple []]}}}\n"
    assert strip_places(loaded(text).jobs["a"].options) == {"v": [["/a", "/b"], []]}

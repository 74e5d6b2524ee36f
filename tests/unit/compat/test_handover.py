"""`rigel` with Rigel installed beside it: whose command is whose."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rigel_k8s.compat import handover


@pytest.fixture
def rigel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An importable package with the modules by which Rigel 0.3 is known."""
    package = tmp_path / "rigel"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "main.py").write_text("def main(): return 'it is Rigel'\n")
    (package / "orchestrator.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    forget()
    yield package
    forget()


def forget() -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "rigel"]:
        del sys.modules[name]


@pytest.mark.parametrize("words", ["rigel run job deploy", "/usr/bin/rigel init --force"])
def test_rigels_own_commands_go_to_rigel(rigel: Path, words: str) -> None:
    """`rigel run` and `rigel init` mean what they mean without this package."""
    entry = handover(words.split())
    assert entry is not None
    assert entry() == "it is Rigel"


@pytest.mark.parametrize(
    "words",
    [
        "rigel",
        "rigel --help",
        "rigel check",
        "rigel cluster up",
        "rigel -f R run job deploy",
        "rigel-k8s run job deploy",
        "/lib/rigel_k8s/__main__.py run job deploy",
    ],
)
def test_all_else_is_ours(rigel: Path, words: str) -> None:
    """Commands and options that Rigel has not, and our own names for the program."""
    assert handover(words.split()) is None


def test_without_rigel_everything_is_ours() -> None:
    """Nothing of Rigel is needed."""
    assert handover(["rigel", "run", "job", "deploy"]) is None


def test_rigel_0_2_is_not_handed_anything(rigel: Path) -> None:
    """It has another grammar and no orchestrator; this package's files are nothing to it."""
    (rigel / "orchestrator.py").unlink()
    assert handover(["rigel", "run", "job", "deploy"]) is None

"""Pods of two versions of rigel, as an update of it leaves them: what their processes note."""

from __future__ import annotations

import json
import os
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from rigel_inpod import rmw_notes
from rigel_inpod.sent import read_module
from tests.support.keepers import WORK

OTHERS = (rmw_notes.VERSION - 1, rmw_notes.VERSION + 1)


def write_notes(directory: Path, version: int, pid: int = os.getpid()) -> Path:
    """Write the beginning of what a process with the layer of a version notes."""
    directory.mkdir(exist_ok=True)
    head = b"rigelrmw" + struct.pack("=II", version, pid)
    (directory / str(pid)).write_bytes(head.ljust(rmw_notes.SLOTS_AT, b"\xff"))
    control = b"rigelctl" + struct.pack("=II", version, WORK)
    (directory / "control").write_bytes(control.ljust(rmw_notes.CONTROL_SIZE, b"\0"))
    return directory


def test_the_header_and_the_reader_have_one_version() -> None:
    """They are twins, in two languages."""
    header = Path(rmw_notes.__file__).parents[1] / "rigel_rmw/layer.h"
    assert f"#define LAYER_VERSION {rmw_notes.VERSION}\n" in header.read_text()


@pytest.mark.parametrize("version", OTHERS)
def test_notes_of_another_version_are_not_read(tmp_path: Path, version: int) -> None:
    """They may have another layout; nor are they changed."""
    notes = write_notes(tmp_path / "n", version)
    before = {path: path.read_bytes() for path in notes.iterdir()}
    assert list(rmw_notes.read_all(str(notes))) == []
    assert rmw_notes.find_other_versions(str(notes)) == {version}
    with pytest.raises(rmw_notes.OtherVersion):
        rmw_notes.Notes(str(notes))
    assert {path: path.read_bytes() for path in notes.iterdir()} == before


def test_notes_of_the_readers_version_are_no_others(tmp_path: Path) -> None:
    """Nor is what is no notes at all."""
    notes = write_notes(tmp_path / "n", rmw_notes.VERSION)
    (notes / "7").write_bytes(b"rigel")
    (notes / "8").write_bytes(b"something else")
    (notes / "x.1").write_bytes(b"rigelrmw\1\0\0\0")
    assert rmw_notes.find_other_versions(str(notes)) == set()


@pytest.mark.parametrize("version", OTHERS)
def test_an_old_pod_is_probed_by_what_its_keeper_says(
    script: Callable[[str], ModuleType], tmp_path: Path, version: int
) -> None:
    """The probe's script is replaced when another version of rigel deploys, its node is not."""
    ready, progress = script("rmw_ready"), script("progress")
    notes = write_notes(tmp_path / "n", version)
    assert ready.look(str(notes), "/talker", False) == []
    says = progress.Progress("works", "works", "", os.getpid(), [str(notes / "progress")])
    says.save()
    assert ready.look(str(notes), "/talker", True) == []
    says.step, says.line = "standby", "waits to take over from talker-1"
    says.save()
    with pytest.raises(ready.NotReady, match=r"waits to take over from talker-1 \[waits\]"):
        ready.look(str(notes), "/talker", True)
    assert ready.main(["stuck", "1"]) == 0


@pytest.mark.parametrize("version", OTHERS)
def test_a_keeper_of_another_version_ends_with_one_line(
    script: Callable[[str], ModuleType],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    version: int,
) -> None:
    """Rather than fail every second; the node goes on, and the probe has the reason."""
    notes = write_notes(tmp_path / "n", version)
    environ = {"RIGEL_RMW": str(notes), "RIGEL_K8S_PEERS": "n-pods"}
    assert script("keeper").main(["run"], environ) == 0
    why = "it cannot be handed over: its keeper ended, and the scripts are now of another version"
    assert capsys.readouterr().out == f"[rigel-k8s] {why} of rigel: restart the node\n"
    ready = script("rmw_ready")
    with pytest.raises(ready.NotReady, match=f"^{why} of rigel: restart the node$"):
        ready.look(str(notes), "/talker", True)
    assert (notes / "control").read_bytes()[12:16] == struct.pack("=I", WORK)


@pytest.mark.parametrize("version", OTHERS)
def test_a_graph_is_not_empty_for_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    version: int,
) -> None:
    """`rigel graph` says why it has no nodes of such a pod."""
    monkeypatch.setenv("RIGEL_RMW", str(write_notes(tmp_path / "n", version)))
    monkeypatch.setitem(sys.modules, "rmw_notes", rmw_notes)
    module: dict[str, Any] = {"__name__": "notes"}
    exec(read_module("rigel_inpod.sent.notes"), module)
    module["main"]("0")
    (why,) = json.loads(capsys.readouterr().out).values()
    assert why.endswith("another version of rigel started this pod: restart the node")

"""The notes of a pod's processes are read by the pod's own reader."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from rigel_inpod import rmw_notes
from rigel_inpod.sent import read_module

OLD = 'def describe(directory):\n    return {"now": 1, "processes": [], "of": directory}\n'


@pytest.mark.parametrize("mounted", [True, False])
def test_the_pods_own_reader_is_taken(
    *,
    mounted: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It knows the layout of an older layer's notes; without one the reader that was sent is."""
    if mounted:
        (tmp_path / "rmw_notes.py").write_text(OLD)
    monkeypatch.setenv("RIGEL_RMW", str(tmp_path))
    monkeypatch.setitem(sys.modules, "rmw_notes", rmw_notes)
    text = read_module("rigel_inpod.sent.notes").replace("/rigel-k8s/", f"{tmp_path}/")
    module = {"__name__": "notes"}
    exec(text, module)  # as the pod does it
    module["main"]("0")  # type: ignore[operator]
    found = json.loads(capsys.readouterr().out)
    assert (found["first"].get("of") == str(tmp_path)) is mounted
    assert found["second"]["processes"] == []

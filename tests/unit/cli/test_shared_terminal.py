"""Where another program writes to the terminal, too, a reporter prints lines only."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from rigel_k8s.cli import reports
from rigel_k8s.cli.main import cli
from rigel_k8s.commands.dev import session as developing
from rigel_k8s.commands.join import session as joining
from tests.support.recorder import Recorder


@pytest.mark.parametrize("words", [["join", "--", "rviz2"], ["dev", "arm", "--sync", "DIR:/ws"]])
def test_its_reporter_prints_lines(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shell of `rigel join` would be drawn over, and has no cursor."""
    plain = []

    @contextmanager
    def reporter(**options: Any) -> Iterator[Recorder]:
        plain.append(options["plain"])
        yield Recorder()

    monkeypatch.setattr(reports, "reporter", reporter)
    monkeypatch.setattr(joining, "join", lambda *_, **__: 0)
    monkeypatch.setattr(developing, "develop", lambda *_: 0)
    CliRunner().invoke(cli, [word.replace("DIR", str(tmp_path)) for word in words])
    assert plain == [True]

"""The example of docs/plugins.md is a whole project: it is run as it stands there."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from rigel_k8s.errors import ProblemsError
from rigel_k8s.jobs.runner import prepare_job
from rigel_k8s.rigelfile import load
from rigel_k8s.settings import Settings
from rigel_k8s.system.trust import trust
from tests.support.recorder import Recorder
from tests.support.running import run_sequence

PAGE = Path(__file__).parents[3] / "docs" / "plugins.md"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """The page's first two code blocks, written to the files that their first lines name."""
    sys.modules.pop("greet", None)
    trust(tmp_path)
    for name, text in re.findall(r"```\w+\n# ([\w.]+)\n(.*?)```", PAGE.read_text(), re.S)[:2]:
        (tmp_path / name).write_text(text)
    return tmp_path / "Rigelfile"


def test_the_example_runs(project: Path, told: Recorder) -> None:
    """One job type in a file beside the Rigelfile, and data from one job to the next."""
    data = run_sequence(load(project), "both", settings=Settings(project), report=told)
    assert told.of("line") == ["hello robot", "hello robot", "hello robot"]
    assert data == {"greeted": "robot"}


def test_the_examples_check_is_heeded(project: Path) -> None:
    """What `check` returns is told with its place."""
    project.write_text(project.read_text().replace("{whom: robot}", "{whom: robot, times: 0}"))
    with pytest.raises(ProblemsError) as caught:
        prepare_job(load(project), "hello", Settings(project))
    (detail,) = caught.value.details
    assert "greet at least once [bad-times]" in detail

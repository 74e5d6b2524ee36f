"""roscore.sh and roscore.py: the image's own roscore, whose master may start slowly."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import rigel_inpod

pytestmark = pytest.mark.programs

START = Path(rigel_inpod.__file__).parent / "roscore.sh"
#: What the real one does: it starts roslaunch with its arguments.
ROSCORE = "import sys, roslaunch.launch as launch\nprint(launch._TIMEOUT_MASTER_START, sys.argv)\n"
#: How roslaunch loads what roscore itself starts and sets.
CONFIG = """
def load_roscore(loader, config, verbose=True):
    config.add_param(("/rosversion", loader), verbose=verbose)
def load_config_default():
    load_roscore("1.16", Config, verbose=False)
class Config:
    params = []
    @classmethod
    def add_param(cls, param, verbose=True):
        cls.params.append(param)
"""


@pytest.fixture
def start(tmp_path: Path) -> Callable[[str], subprocess.CompletedProcess[str]]:
    """Run `roscore -p 1` with this text as roscore, "" for none, beside a roslaunch."""
    (tmp_path / "roslaunch").mkdir()
    (tmp_path / "roslaunch/__init__.py").touch()
    (tmp_path / "roslaunch/launch.py").write_text("_TIMEOUT_MASTER_START = 10.0\n")
    (tmp_path / "roslaunch/core.py").write_text("def Param(key, value): return key, value\n")
    (tmp_path / "roslaunch/config.py").write_text(CONFIG)
    env = {**os.environ, "PATH": f"{tmp_path}:/usr/bin:/bin", "PYTHONPATH": str(tmp_path)}

    def run(text: str) -> subprocess.CompletedProcess[str]:
        if text:
            (tmp_path / "roscore").write_text(text)
            (tmp_path / "roscore").chmod(0o755)
        command = ["/bin/sh", str(START), "-p", "1"]
        return subprocess.run(command, env=env, capture_output=True, text=True)

    return run


@pytest.fixture(params=["2.7", "3", "env"])
def python(request: pytest.FixtureRequest) -> str:
    """The first line of a roscore, without `#!`."""
    if request.param == "env":
        return "/usr/bin/env python3"
    return request.getfixturevalue("python2") if request.param == "2.7" else sys.executable


def test_its_master_has_two_minutes(
    python: str, start: Callable[[str], subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """With the arguments that were given, and the name that roscore has."""
    done = start(f"#!{python}\n{ROSCORE}")
    assert done.returncode == 0, done.stderr
    words = f"{[str(tmp_path / 'roscore'), '-p', '1']}"
    assert done.stdout in (f"120.0 {words}\n", f"(120.0, {words})\n")


def test_rospy_nodes_need_not_request_with_each_line_what_is_not_set(
    python: str, start: Callable[[str], subprocess.CompletedProcess[str]]
) -> None:
    """The parameter has its default, beside what roscore sets by itself."""
    look = "import roslaunch.config as c\nc.load_config_default()\nprint(c.Config.params)\n"
    done = start(f"#!{python}\n{look}")
    wanted = [("/rosversion", "1.16"), ("/rosout_disable_topics_generation", False)]
    assert done.stdout == f"{wanted}\n", done.stderr


def test_another_program_runs_as_it_is(
    start: Callable[[str], subprocess.CompletedProcess[str]],
) -> None:
    """An image may have a script of that name."""
    assert start('#!/bin/sh\necho "mine $*"\n').stdout == "mine -p 1\n"


def test_none_at_all_is_reported(
    start: Callable[[str], subprocess.CompletedProcess[str]],
) -> None:
    """As a shell does."""
    done = start("")
    assert done.returncode == 127
    assert "roscore" in done.stderr

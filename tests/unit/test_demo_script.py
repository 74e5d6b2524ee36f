"""What the demos do before their Rigelfile: a cluster and a base image, side by side."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rigel_k8s.cli.main import list_all_commands

pytestmark = pytest.mark.programs

SCRIPT = Path(__file__).parents[2] / "examples/demo.sh"
#: Notes its words; the base image's build waits until the cluster is up.
RIGEL = """#!/bin/sh
echo "$*" >>{directory}/calls
case "$*" in
  *"cluster up"*) while ! grep -q "^image" {directory}/calls; do sleep 0.02; done ;;
  *"cluster status"*) echo '{{"registry": "10.0.0.2:5000"}}' ;;
  "image ros1-base") echo "no archive of Debian" >&2; exit {fails} ;;
esac
"""
DEMO = """set -euo pipefail
. {script}
local_cluster demo ros1-base --nodes 2
base_image ros1-base noetic ros:noetic-ros-base
echo "then $REGISTRY $BASE_IMAGE"
next_steps </dev/null
"""


def demo(directory: Path, *, fails: int = 0, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a demo with a rigel-k8s that only notes what it is asked for."""
    program = directory / "rigel-k8s"
    program.write_text(RIGEL.format(directory=directory, fails=fails))
    program.chmod(0o755)
    environment = {**os.environ, "PATH": f"{directory}:{os.environ['PATH']}"}
    for name in ("CONTEXT", "REGISTRY", "BASE_IMAGE"):
        environment.pop(name, None)
    return subprocess.run(
        ["bash", "-c", DEMO.format(script=SCRIPT)],
        capture_output=True,
        text=True,
        env=environment | variables,
        timeout=60,
        check=False,
    )


def calls(directory: Path) -> list[str]:
    file = directory / "calls"
    return file.read_text().splitlines() if file.exists() else []


def test_the_base_image_is_built_while_the_cluster_comes_up(tmp_path: Path) -> None:
    """It takes as long as the cluster, which does not need it; it is pushed afterwards."""
    done = demo(tmp_path)
    assert done.returncode == 0, done.stderr
    assert sorted(calls(tmp_path)[:2]) == ["cluster up --name demo --nodes 2", "image ros1-base"]
    assert calls(tmp_path)[2:] == [
        "cluster status --name demo -o json",
        "image ros1-base --push 10.0.0.2:5000/ros:noetic",
        "image ros1-base --push 10.0.0.2:5000/library/ros:noetic",
    ]
    assert "then 10.0.0.2:5000 10.0.0.2:5000/ros:noetic" in done.stdout
    assert "cluster down --name demo" in done.stdout


@pytest.mark.parametrize("demo", sorted(SCRIPT.parent.glob("*/demo")), ids=lambda p: p.parent.name)
def test_each_demo_ends_with_what_to_look_at(demo: Path) -> None:
    """The page and the graph among it; all are commands that exist."""
    named = re.findall(r"^  rigel (\w+)", demo.read_text().partition("next_steps")[2], re.MULTILINE)
    assert {"ui", "graph", "logs", "history", "down"} <= {*named}
    assert {*named} <= list_all_commands().keys()


def test_the_longest_gap_is_printed_with_what_is_normal() -> None:
    """Of the lines with a word alone."""
    stamps = ("00.0", "00.1", "00.2", "00.45", "00.55")
    lines = [f"2026-01-01T00:00:{stamp}Z I heard: {name}" for stamp in stamps for name in "ab"]
    script = [sys.executable, str(SCRIPT.parent / "longest_gap.py"), "b"]
    done = subprocess.run(
        script, input="\n".join(lines), text=True, capture_output=True, check=True
    )
    assert done.stdout == (
        "5 messages, usually one every 0.10 s; the longest time without one: 0.25 s"
        " (an update adds about 0.1 s; a busy machine needs longer)\n"
    )


def test_a_base_image_that_fails_says_why(tmp_path: Path) -> None:
    """What it printed meanwhile is shown, and nothing is deployed."""
    done = demo(tmp_path, fails=3)
    assert done.returncode == 1
    assert "no archive of Debian" in done.stderr
    assert "then" not in done.stdout


def test_with_a_cluster_of_ones_own_nothing_is_built(tmp_path: Path) -> None:
    """The official image is pulled there."""
    done = demo(tmp_path, CONTEXT="mine", REGISTRY="host/path")
    assert done.returncode == 0, done.stderr
    assert calls(tmp_path) == []
    assert "then host/path ros:noetic-ros-base" in done.stdout


def test_a_cluster_of_ones_own_needs_a_registry(tmp_path: Path) -> None:
    """The error says which variable is missing."""
    done = demo(tmp_path, CONTEXT="mine")
    assert done.returncode == 2
    assert "REGISTRY=<host/path>" in done.stderr

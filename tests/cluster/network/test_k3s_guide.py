"""docs/k3s.md, word by word: its Rigelfile and its commands, on nodes laid out as Leda's."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.network.options import Install
from rigel_k8s.release.types import DeployOptions
from rigel_lab import cluster as lab
from rigel_multus.removal import remove
from tests.support.recorder import Recorder
from tests.support.ros2base import push_ros2

pytestmark = pytest.mark.cluster

GUIDE = Path(__file__).parents[3] / "docs/k3s.md"
MARK = "----8<----"


def blocks(language: str) -> list[str]:
    """Return the guide's blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", GUIDE.read_text("utf-8"), re.M | re.S)


def commands() -> list[tuple[str, list[str]]]:
    """Return each command and the lines that the guide shows of what it prints."""
    found: list[tuple[str, list[str]]] = []
    for line in "".join(blocks("console")).splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        else:
            found[-1][1].append(line)
    return found


@pytest.fixture(scope="module")
def laptop(own: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a kubeconfig and the guide's Rigelfile; the cluster is without Multus."""
    if not own.data_dir:
        pytest.skip("of k3s only")
    remove(own.cluster, Install(), DeployOptions(report=Recorder()))
    place = tmp_path_factory.mktemp("laptop")
    (place / "k3s.yaml").write_text(lab.kubeconfig_text(own.name))
    (rigelfile,) = blocks("yaml")
    (place / "Rigelfile").write_text(rigelfile)
    registry = lab.status(own.name).registry
    push_ros2(f"{registry}/library/ros:jazzy")
    return place


def test_the_guides_commands_do_what_it_says(laptop: Path) -> None:
    """Every command succeeds, in one shell as a reader would, and prints what the guide shows."""
    listed = commands()
    assert [command.split()[0] for command, _ in listed].count("rigel") >= 8
    script = "\n".join(
        f"{waiting(command, shown)}echo '{MARK}'\n{command}" for command, shown in listed
    )
    done = subprocess.run(
        ["bash", "-e", "-c", script],
        check=False,
        cwd=laptop,
        env=environment(laptop),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=800,
    )
    printed = done.stdout.split(f"{MARK}\n")[1:]
    assert done.returncode == 0, done.stdout
    assert len(printed) == len(listed)
    for (command, shown), output in zip(listed, printed, strict=True):
        for line in shown:
            assert any(matches(line, given) for given in output.splitlines()), (command, output)


def waiting(command: str, shown: list[str]) -> str:
    """Return what waits for a log: nodes are ready a moment before they hear each other."""
    if not command.startswith("rigel logs"):
        return ""
    line = shown[0].strip(".")
    look = f"{command} 2>/dev/null | grep '{line}' >/dev/null && break"
    return f"for _ in $(seq 60); do {look}; sleep 1; done\n"


def matches(shown: str, given: str) -> bool:
    """Whether a printed line is as the guide shows it; `...` stands for anything."""
    pattern = re.sub(r"([\[\]*?])", r"[\1]", shown).replace("...", "*")
    return fnmatchcase(given.rstrip(), pattern)


def environment(laptop: Path) -> dict[str, str]:
    """Return the variables of a laptop that has rigel and no kubeconfig of its own."""
    programs = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    kept = {name: os.environ[name] for name in ("LANG", "LC_ALL") if name in os.environ}
    return {"PATH": programs, "HOME": str(laptop), "NO_COLOR": "1", **kept}

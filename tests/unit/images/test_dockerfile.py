"""The texts of Dockerfiles and entrypoints: a golden file for each option."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from rigel_build.recipe import (
    Recipe,
    dockerfile,
    entrypoint,
    exec_form,
    render_dockerignore,
)
from tests.support.golden import Golden

GOLDEN = Path(__file__).parent / "golden"

NOETIC: dict[str, Any] = {"distro": "noetic", "base": "ros:noetic", "source_name": "demo"}
HUMBLE: dict[str, Any] = {"distro": "humble", "base": "ros:humble", "source_name": "demo"}
HELLO: dict[str, Any] = {"packages": ("src/hello",)}

CASES = {
    "plain-ros1": Recipe(**NOETIC, command="rosrun demo talker.py"),
    "plain-ros2": Recipe(**HUMBLE, compiler="colcon"),
    "catkin": Recipe(**NOETIC, **HELLO, command="roslaunch hello hello.launch"),
    "catkin-melodic": Recipe("melodic", "ros:melodic", "demo", ("hello",)),
    "one-package": Recipe(**NOETIC, packages=(".",)),
    "colcon": Recipe(**HUMBLE, **HELLO, compiler="colcon", command=("ros2", "run", "a", "b c")),
    "compiler-none": Recipe(**NOETIC, **HELLO, compiler="none"),
    "cmake-args": Recipe(
        **NOETIC, **HELLO, cmake_args={"CMAKE_BUILD_TYPE": "Release", "-DFLAGS": "-O2 -g"}
    ),
    "no-rosdep": Recipe(**NOETIC, **HELLO, rosdep=False),
    "apt": Recipe(**NOETIC, apt=("ros-noetic-tf", "curl=7.*")),
    "env": Recipe(**NOETIC, env=(("PATH", "/opt/a:$PATH"), ("QUOTED", 'a "b" \\ \\$c d'))),
    "docker-run": Recipe(**NOETIC, docker_run=("mkdir /data", "echo a\necho b", "a \\\n  b")),
    "entrypoint": Recipe(**NOETIC, entrypoint=("export A=b", "echo $A")),
    "python-requirements": Recipe(**NOETIC, python_requirements=("requirements.txt", "a b.txt")),
    "rosinstall": Recipe(**NOETIC, rosinstall=("deps.rosinstall", "more/x y.repos")),
    "root": Recipe(**NOETIC, **HELLO, username="root"),
}


def make(name: str) -> list[dict[str, str]]:
    """Return the texts of a case."""
    texts = {"Dockerfile": dockerfile(CASES[name]), "entrypoint": entrypoint(CASES[name])}
    return [{"file": file, "text": text} for file, text in texts.items()]


FOLDER = Golden(GOLDEN, make, ("catkin", "plain-ros1", "root"), CASES)


@pytest.mark.parametrize("name", CASES)
def test_the_text_is_the_golden_one(name: str, *, update_golden: bool) -> None:
    """Dockerfile and entrypoint of each option are what was looked at and found good."""
    FOLDER.compare(name, update=update_golden)


def test_no_golden_file_is_left_over() -> None:
    """Each golden file belongs to a case."""
    assert {file.stem for file in GOLDEN.iterdir()} == set(CASES)


@pytest.mark.programs
@pytest.mark.parametrize("name", CASES)
def test_entrypoints_are_valid_shell(name: str) -> None:
    """bash reads every entrypoint."""
    script = entrypoint(CASES[name])
    assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


@pytest.mark.programs
@pytest.mark.parametrize("name", CASES)
def test_steps_are_valid_shell(name: str) -> None:
    """sh reads every RUN step."""
    text = dockerfile(CASES[name]).replace("\\\n", "")
    steps = [line[4:] for line in text.splitlines() if line.startswith("RUN ") and line[4] != "["]
    assert steps
    for step in steps:
        assert subprocess.run(["sh", "-n"], input=step, text=True, check=False).returncode == 0


def test_apt_leaves_nothing_behind() -> None:
    """No layer has apt's lists or packages that were only recommended."""
    steps = [step for case in CASES.values() for step in dockerfile(case).split("\nRUN ")[1:]]
    installs = [step for step in steps if "apt-get install" in step]
    assert len(installs) >= 10
    for step in installs:
        assert "--no-install-recommends" in step
        assert "rm -rf /var/lib/apt/lists/*" in step


def test_the_sources_come_after_what_they_need() -> None:
    """An edit of the sources renews no layer of packages or dependencies."""
    text = dockerfile(CASES["catkin"])
    sources = text.index("COPY --chown=rigeluser:rigeluser . ")
    assert text.index("apt-get install") < sources
    assert text.index("rosdep install") < sources
    assert sources < text.index("catkin_make")


@pytest.mark.programs
def test_the_entrypoint_gives_its_place_to_the_command(tmp_path: Path) -> None:
    """The command runs under the entrypoint's own process id, so signals reach it."""
    lines = entrypoint(CASES["plain-ros1"]).splitlines()
    script = tmp_path / "entrypoint.sh"
    # Without the lines that need an image around them.
    script.write_text("\n".join(line for line in lines if not line.startswith(("source", "cd "))))
    with subprocess.Popen(
        ["bash", str(script), "sh", "-c", "echo $$"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert int(process.stdout.read()) == process.pid


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("", ()),
        ("roslaunch a b.launch x:=1", ("roslaunch", "a", "b.launch", "x:=1")),
        ("echo 'a b'", ("echo", "a b")),
        ('["rosrun", "a", "b"]', ("rosrun", "a", "b")),
        (("rosrun", "a b"), ("rosrun", "a b")),
        ("a && b", ("bash", "-c", "a && b")),
        ("echo $HOME", ("bash", "-c", "echo $HOME")),
        ("A=1 rosrun a b", ("bash", "-c", "A=1 rosrun a b")),
        ("[ -e /x ]", ("[", "-e", "/x", "]")),
        ("a\nb", ("bash", "-c", "a\nb")),
    ],
)
def test_a_shell_stands_only_where_it_is_needed(
    command: str | tuple[str, ...], words: tuple[str, ...]
) -> None:
    """A plain command is the container's first process; shell syntax gets a shell."""
    assert exec_form(command) == words


def test_the_last_line_is_a_command() -> None:
    """An image without a command of its own starts a shell, for an ENTRYPOINT drops the base's."""
    assert dockerfile(CASES["plain-ros2"]).splitlines()[-1] == f"CMD {json.dumps(['bash'])}"


def test_a_workspace_leaves_out_what_was_built_in_it() -> None:
    """build/ and devel/ of a workspace stay out; those of a single package may be its own."""
    assert "devel" in render_dockerignore(["src/hello"]).splitlines()
    assert "devel" not in render_dockerignore(["."]).splitlines()

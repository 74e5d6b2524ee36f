"""start.sh: what only the image knows is put into a command line, with the Pythons of ROS images.

What it sets at a master is tests/ros1's matter.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import rigel_inpod

pytestmark = pytest.mark.programs

START = Path(rigel_inpod.__file__).parent / "start.sh"
Run = Callable[..., subprocess.CompletedProcess[str]]
#: What ROS 1 has: knows one package.
ROSPACK = (
    '#!/bin/sh\n[ "$2" = nav ] && echo /opt/ros/share/nav && exit 0\necho no such >&2\nexit 1\n'
)
#: A program that prints its arguments, one a line, and a variable.
SHOW = ["/bin/sh", "-c", 'printf "%s\\n" "$@" "$MAP"', "sh"]
#: Runs what follows where no file can have any content.
NO_FILES = ("/bin/sh", "-c", 'ulimit -f 0; exec "$@"', "sh")


@pytest.fixture(params=["2.7", "3"])
def start(request: pytest.FixtureRequest, tmp_path: Path) -> Run:
    """Run start.sh in an image with one Python, a rospack and the ROS 2 package nav."""
    old = request.param == "2.7"
    python = request.getfixturevalue("python2") if old else sys.executable
    (tmp_path / "python").symlink_to(python)
    (tmp_path / "rospack").write_text(ROSPACK)
    (tmp_path / "rospack").chmod(0o755)
    index = tmp_path / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "nav").touch()

    def run(
        *words: str, before: Sequence[str] = (), **env: str
    ) -> subprocess.CompletedProcess[str]:
        own = {"PATH": f"{tmp_path}:/bin", "AMENT_PREFIX_PATH": f"/nowhere:{tmp_path}", **env}
        line = [*before, "/bin/sh", str(START), *words]
        return subprocess.run(line, env=own, capture_output=True, text=True, cwd=tmp_path)

    return run


def shown(done: subprocess.CompletedProcess[str]) -> list[str]:
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("$(find nav)/maps/a.yaml", "/opt/ros/share/nav/maps/a.yaml"),
        ("$(find-pkg-share nav)", "/opt/ros/share/nav"),
        ("_a:=$(find nav):$(env ROBOT)", "_a:=/opt/ros/share/nav:r7"),
        ("$(env ROBOT r1)$(env NO r1)", "r7r1"),
        ("$(optenv ROBOT)-$(optenv NO)-$(optenv NO two words)", "r7--two words"),
        ("$(date) $(POD_NAME) $(find a b) $(arg x)", "$(date) $(POD_NAME) $(find a b) $(arg x)"),
        ("$(echo $(env ROBOT)) $(open", "$(echo r7) $(open"),
        ("$(env QUOTE)", "a $(find nope) 'b"),
    ],
)
def test_expressions_are_replaced(start: Run, word: str, expected: str):
    """Each once, and nothing that is none of ours; a word stays one word."""
    done = start(
        *("ros1", "--substitute", "--", *SHOW, word), ROBOT="r7", QUOTE="a $(find nope) 'b"
    )
    assert shown(done) == [expected, ""]


def test_nothing_is_replaced_unless_asked(start: Run):
    """A program with parameters of its image may have words of its own that look alike."""
    assert shown(start("ros1", "--", *SHOW, "$(find nav)")) == ["$(find nav)", ""]


def test_variables_are_replaced_in_the_order_written(start: Run, tmp_path: Path):
    """Those that the user wrote an expression into; one may use another."""
    words = ("--substitute", "--env", "BASE", "--env", "MAP", "--", *SHOW)
    done = start(
        "ros2", *words, BASE="$(find nav)/maps", MAP="$(env BASE)/$(env KEPT)", KEPT="$(x)"
    )
    assert shown(done) == [f"{tmp_path}/share/nav/maps/$(x)"]


def test_the_program_reads_a_completed_copy_of_a_file(start: Run, tmp_path: Path):
    """Of what is loaded beside a node; with the node's own variables, and numbers as numbers."""
    plan = {"components": [{"name": "/a", "parameters": {"map": "$(env MAP)", "n": "$(env N)"}}]}
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(plan))
    words = ("--substitute", "--complete", str(path), "--env", "MAP", "--", *SHOW, "-v", str(path))
    verbose, copy, _ = shown(
        start("ros1", *words, MAP="$(find nav)/a", N="2", TMPDIR=str(tmp_path))
    )
    (component,) = json.loads(Path(copy).read_text())["components"]
    assert component == {"name": "/a", "parameters": {"map": "/opt/ros/share/nav/a", "n": 2}}
    assert (verbose, json.loads(path.read_text())) == ("-v", plan)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["ros1", "--substitute", "--", "true", "$(find sensors)"],
            "rigel: $(find sensors): this image has no package sensors (ROS_PACKAGE_PATH=/ws)\n",
        ),
        (
            ["ros2", "--substitute", "--", "true", "$(find sensors)"],
            "rigel: $(find sensors): this image has no package sensors (AMENT_PREFIX_PATH={})\n",
        ),
        (
            ["ros1", "--substitute", "--", "true", "$(env ROBOT)"],
            "rigel: the environment variable ROBOT of $(env ROBOT) is not set\n",
        ),
        (
            [
                "ros2",
                "--run",
                "urdf",
                "sh -c 'echo one >&2; echo two >&2; exit 4'",
                "--",
                "true",
            ],
            "rigel: the command of the parameter urdf, `sh -c echo one >&2; echo two >&2; exit 4`,"
            " failed with exit code 4: two\n",
        ),
        (
            ["ros1", "--run", "/n/urdf", "xacro a.xacro", "--", "true"],
            "rigel: the command of the parameter urdf, `xacro a.xacro`, cannot be run:"
            " No such file or directory\n",
        ),
        (
            ["ros1", "--load", "/config/a.yaml", "/n", "--", "true"],
            "rigel: there is no parameter file /config/a.yaml in this image\n",
        ),
        (
            ["ros1", "--run", "/n/urdf", "echo x", "--", "true"],
            "rigel: this image has no rosgraph for Python, or ROS is not set up\n",
        ),
        (["ros1", "--", "talker"], "rigel: talker cannot be run: No such file or directory\n"),
    ],
)
def test_what_is_missing_is_reported_in_one_line(start: Run, words: list[str], line: str):
    """The last line of the container's log is what `rigel run` and `rigel status` show."""
    done = start(*words, ROS_PACKAGE_PATH="/ws", AMENT_PREFIX_PATH="/opt/ros")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == line.replace("{}", "/opt/ros")


def test_parameters_of_ros2_get_into_a_file_at_the_end(start: Run, tmp_path: Path):
    """Which rcl reads as YAML; a text that becomes a number or truth is one."""
    values = {"map": "$(find nav)/a", "rate": "$(env RATE)", "on": ["$(env ON)", True], "text": "7"}
    (tmp_path / "values.json").write_text(json.dumps(values))
    words = ["--substitute", "--values", "values.json", "/**", "--run", "urdf", "cat '$(env FILE)'"]
    (tmp_path / "robot.urdf").write_text('<robot name="é"/>\n')
    done = start(
        *("ros2", *words, "--", *SHOW, "a", "--ros-args", "-r", "__node:=n"),
        **{"RATE": "2", "ON": "True", "FILE": "robot.urdf", "TMPDIR": str(tmp_path)},
    )
    *line, path, _ = shown(done)
    assert line == ["a", "--ros-args", "-r", "__node:=n", "--ros-args", "--params-file"]
    assert json.loads(Path(path).read_text()) == {
        "/**": {
            "ros__parameters": {
                "map": f"{tmp_path}/share/nav/a",
                "rate": 2,
                "on": [True, True],
                "text": "7",
                "urdf": '<robot name="é"/>\n',
            }
        }
    }


@pytest.mark.parametrize(
    ("written", "ros1", "ros2"),
    [
        (["$(env TWO)", 3], [2, 3], [2, 3]),
        (["$(env TWO)", 1.5], [2, 1.5], [2.0, 1.5]),
        (["$(env TWO)", "$(env NAME)"], [2, "r7"], ["2", "r7"]),
        (["$(env TWO)", "$(env TRUE)"], [2, True], ["2", "True"]),
        (["$(env TRUE)", False], [True, False], [True, False]),
        ({"a": [["$(env TWO)", "x"]]}, {"a": [[2, "x"]]}, {"a": [["2", "x"]]}),
        ([1, "$(env NAME)"], [1, "r7"], None),
        ([1.5, "$(env TRUE)"], [1.5, True], None),
    ],
)
def test_a_list_of_ros2_has_one_type(
    start: Run, tmp_path: Path, written: Any, ros1: Any, ros2: Any
):
    """ROS 2 refuses all others, and what the texts of a list become is known here alone."""
    (tmp_path / "plan.json").write_text(json.dumps(written))
    words = ("--substitute", "--complete", "plan.json", "--", *SHOW, "plan.json")
    variables = {"TWO": "2", "NAME": "r7", "TRUE": "True", "TMPDIR": str(tmp_path)}
    for ros, expected in (("ros1", ros1), ("ros2", ros2)):
        done = start(ros, *words, **variables)
        if expected is None:
            assert done.returncode == 1
            assert "must have one type in ROS 2\n" in done.stderr
        else:
            found = json.loads(Path(shown(done)[0]).read_text())
            assert json.dumps(found) == json.dumps(expected)


@pytest.mark.parametrize(
    "words", [("--values", "values.json", "/**"), ("--complete", "values.json")]
)
def test_a_container_that_cannot_write_is_reported(start: Run, tmp_path: Path, words: list[str]):
    """Also if there is a directory, but the file system is full; nothing is left there."""
    (tmp_path / "values.json").write_text('{"a": 1}')
    before = set(Path("/dev/shm").glob("rigel-k8s-*"))
    done = start("ros2", "--substitute", *words, "--", "true", before=NO_FILES)
    assert (done.returncode, done.stderr) == (
        1,
        "rigel: no file can be written in $TMPDIR, /tmp or /dev/shm: File too large;"
        " mount a volume at /tmp\n",
    )
    assert set(Path("/dev/shm").glob("rigel-k8s-*")) == before


def test_a_container_without_a_writable_tmp_uses_its_shared_memory(
    script: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """As one with a read-only file system and no volume at /tmp."""
    start = script("start")
    monkeypatch.setattr(start.tempfile, "tempdir", str(tmp_path / "missing"))
    monkeypatch.setattr(start, "SHARED_MEMORY", str(tmp_path))
    path = Path(start.write_json({"a": 1}))
    assert (path.parent, json.loads(path.read_text())) == (tmp_path, {"a": 1})


def test_global_parameters_of_a_container_that_cannot_write(
    script: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The readiness probe reads a file, so its absence is the cause."""
    parameters = script("globalparameters")
    monkeypatch.setattr(parameters, "STATE", str(tmp_path / "missing/state"))
    with pytest.raises(script("substitution").Failure, match=r"cannot write .*state: No such"):
        parameters.write("set")


def test_global_parameters_that_are_no_longer_wanted_are_deleted(
    script: Callable[[str], ModuleType],
):
    """And one that someone has changed stays, as long as the same ones are wanted."""
    parameters = script("globalparameters")
    held: dict[str, object] = {}
    master = SimpleNamespace(
        hasParam=held.__contains__,
        getParam=held.__getitem__,
        setParam=held.__setitem__,
        deleteParam=held.__delitem__,
    )
    old = {"digest": "1", "names": ["/a", "/b"]}
    assert parameters.set_again(master, "/mark", old, [("/a", 1), ("/b", 2)])
    held["/a"] = 7
    assert not parameters.set_again(master, "/mark", old, [("/a", 1), ("/b", 2)])
    assert held["/a"] == 7
    assert parameters.set_again(master, "/mark", {"digest": "2", "names": ["/b"]}, [("/b", 3)])
    assert set(held) == {"/mark", "/b"}


def test_it_becomes_the_program(start: Run):
    """The exit code and the process are the program's: signals reach it, and probes see it."""
    done = start("ros1", "--substitute", "--", "/bin/sh", "-c", "kill -9 $$")
    assert done.returncode == -9


def test_a_failure_stands_in_the_containers_status(
    script: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """`rigel status` shows it there; where there is no Kubernetes, no file is made."""
    start, file = script("start"), tmp_path / "termination-log"
    monkeypatch.setattr(start, "TERMINATION", str(file))
    start.report("why")
    assert not file.exists()
    file.touch()
    start.report("why")
    assert file.read_text() == "why"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("2", 2), ("-3", -3), ("1e3", 1000.0), ("0.5", 0.5), ("True", True), ("false", False)),
        *(("nan", "nan"), ("1_0", "1_0"), ("1.2.3", "1.2.3"), ("", ""), ("e", "e"), ("yes", "yes")),
    ],
)
def test_types(script: Callable[[str], ModuleType], text: str, value: object):
    """As roslaunch reads them."""
    found = script("substitution").give_type(text)
    assert (found, type(found)) == (value, type(value))


def test_an_image_without_python(tmp_path: Path):
    """Is reported, and starts nothing."""
    done = subprocess.run(
        ["/bin/sh", str(START), "ros1", "--", "true"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (3, "")
    assert "this image has no Python" in done.stderr

"""Launch files in Python are evaluated by the launch of an image, and become what it would start.

RIGEL_LAUNCH_PYTHON names an interpreter with ROS 2's launch_ros, which PyPI does not have. With it
`pytest tests/unit/importing --update-golden` writes the document that ROS makes of the sample, and
then its Rigelfile. Without it the sample is read from that document.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from rigel_import.draft import Draft
from rigel_import.launch import evaluator
from rigel_import.launch.evaluation import evaluate, read_output, select_outermost
from rigel_import.launch.reading import read, read_python
from rigel_k8s.cli.main import run
from rigel_k8s.errors import CommandFailed, UserError
from rigel_k8s.system.process import Finished

PYTHON = os.environ.get("RIGEL_LAUNCH_PYTHON", "")
real = pytest.mark.skipif(
    not PYTHON, reason="RIGEL_LAUNCH_PYTHON names no interpreter of an environment with launch_ros"
)
FOLDER = Path(__file__).parent / "launch"
SAMPLE = "src/rover_bringup/launch/rover.launch.py"
DOCUMENT = FOLDER / "ros2-python/src/rover_bringup/launch/rover.launch.json"
IMAGE = ("--image", "registry.example/r:1", "--distro", "jazzy")
EMPTY: dict[str, Any] = {
    "arguments": [],
    "commands": {},
    "components": [],
    "processes": [],
    "remarks": [],
    "shares": {},
    "temporary": "/tmp",
}


@pytest.fixture(autouse=True)
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run each test in a copy of the sample's workspace."""
    place = shutil.copytree(FOLDER / "ros2-python", tmp_path / "w")
    monkeypatch.chdir(place)
    return place


# With ROS


def evaluate_with_ros(request: Mapping[str, Any], folder: Path, **env: str) -> dict[str, Any]:
    """Return the document of an image that has the sample's package."""
    share, made = folder / "image/share", folder / "made"
    if not share.exists():
        shutil.copytree(FOLDER / "ros2-python/src/rover_bringup", share / "rover_bringup")
        (share / "ament_index/resource_index/packages").mkdir(parents=True)
        (share / "ament_index/resource_index/packages/rover_bringup").touch()
        made.mkdir()
    found = os.environ.get("AMENT_PREFIX_PATH", "")
    prefixes = os.pathsep.join(filter(None, [str(share.parent), found]))
    script = Path(evaluator.__file__).read_text()
    done = subprocess.run(
        [PYTHON, "-c", script, json.dumps({"arguments": {}, **request})],
        env={**os.environ, "AMENT_PREFIX_PATH": prefixes, "TMPDIR": str(made), **env},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    before, _, text = done.stdout.partition(f"{evaluator.BEGIN}\n")
    assert not before.strip()
    return json.loads(text.partition(evaluator.END)[0])  # type: ignore[no-any-return]


@real
@pytest.mark.programs
def test_ros_finds_what_the_document_has(
    workspace: Path,
    tmp_path: Path,
    update_golden: bool,  # noqa: FBT001 - a fixture
) -> None:
    """What humble, jazzy and rolling make of the sample; no path of the machine is in it."""
    found = evaluate_with_ros({"file": [str(workspace / SAMPLE)]}, tmp_path)
    text = json.dumps(found, indent=1)
    for path, name in (("w", "/WORKSPACE"), ("image", "/IMAGE"), ("made", "/MADE")):
        text = text.replace(str(tmp_path / path), name)
    names = dict.fromkeys(re.findall(r"/MADE/(\w+)", text))
    for number, name in enumerate(names):
        text = text.replace(name, f"file{number}")
    if update_golden:
        DOCUMENT.write_text(f"{text}\n")
    assert json.loads(text) == json.loads(DOCUMENT.read_text())


@real
@pytest.mark.programs
@pytest.mark.parametrize(
    ("text", "message", "line"),
    [
        ("import nowhere", "ModuleNotFoundError: No module named 'nowhere'", 1),
        ("\ndef f(:", "SyntaxError: invalid syntax", 2),
        ("def generate_launch_description():\n    raise OSError('a\\nb')", "OSError: a\nb", 2),
        (
            "from launch import LaunchDescription\nfrom launch_ros.actions import Node\n"
            "def generate_launch_description():\n    return LaunchDescription([\n"
            "      Node(package='p', executable='e', namespace='a b')])",
            "InvalidNamespaceException",
            5,
        ),
    ],
)
def test_an_error_of_a_launch_file_has_its_place(
    text: str, message: str, line: int, tmp_path: Path
) -> None:
    """Also one that is raised only when ROS looks at an action."""
    file = tmp_path / "a.launch.py"
    file.write_text(text)
    error = evaluate_with_ros({"file": [str(file)]}, tmp_path)["error"]
    assert message in error["message"]
    assert error["place"] == [str(file), line]


@real
@pytest.mark.programs
def test_a_file_of_the_image_gets_what_is_set_around_it(tmp_path: Path) -> None:
    """It is found by its package and name, or by an expression, and arguments may have these."""
    around = {
        "namespace": "a",
        "env": {"E": "$(optenv NOTHING) $(env LAMP 2)"},
        "parameters": {"q": True},
        "remappings": {"c": "d"},
    }
    for file in (
        ["rover_bringup", "lights.launch.xml"],
        ["$(find rover_bringup)/launch/lights.launch.xml"],
    ):
        request = {"file": file, "around": around}
        (lights, _) = evaluate_with_ros(request, tmp_path, LAMP="3")["processes"]
        words = ["-r", "__node:=lights", "-r", "__ns:=/a/lamps", "-p", "q:=True", "-r", "c:=d"]
        assert lights["command"][1:] == ["--ros-args", *words]
        assert lights["env"] == {"E": " 3"}
        assert lights["place"][0].endswith("image/share/rover_bringup/launch/lights.launch.xml")
    missing = evaluate_with_ros({"file": ["rover_bringup", "x.py"]}, tmp_path)["error"]
    assert "rover_bringup has no files x.py" in missing["message"]


# From its document


@pytest.fixture
def image(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Any]]:
    """Let an image evaluate each file as a document, by default the sample's; note the requests."""

    def answer(**changes: Any) -> list[Any]:
        text = DOCUMENT.read_text().replace("/WORKSPACE", str(workspace))
        document = {**EMPTY, **changes} if changes else json.loads(text)
        requests: list[Any] = []

        def evaluate(request: Any, image: str, folders: Any) -> Any:
            requests.append((request, image, select_outermost(folders)))
            return document

        monkeypatch.setattr("rigel_import.launch.python.evaluate", evaluate)
        return requests

    return answer


def make_process(*command: str, **changes: Any) -> dict[str, Any]:
    """Return a process as the evaluator describes it; a word may be `PACKAGE EXECUTABLE`."""
    mark = evaluator.MARK
    words = [re.sub(r"^(\w+) (\w+)$", rf"{mark}\1{mark}\2{mark}", word) for word in command]
    process = {"command": words, "env": {}, "files": {}, "lost": [], "name": words[0]}
    return {**process, "place": ["a.launch.py", 7], "shell": False, "waiting": [], **changes}


def convert(image: Callable[..., Any], *command: str, **changes: Any) -> Draft:
    """Return the draft of a launch file that starts one process."""
    image(processes=[make_process(*command, **changes)])
    return read(Path(SAMPLE), {}, {}, "r:1", "jazzy")


def test_the_sample_becomes_its_rigelfile(
    image: Callable[..., Any],
    update_golden: bool,  # noqa: FBT001 - a fixture
    capsys: pytest.CaptureFixture[str],
) -> None:
    """`rigel check` accepts it, with the parameter file that the launch file makes."""
    image()
    assert run(["import", "launch", SAMPLE, *IMAGE], "rigel") == 0
    golden = FOLDER / "ros2-python.Rigelfile"
    if update_golden:
        shutil.copy("Rigelfile", golden)
    assert Path("Rigelfile").read_text() == golden.read_text()
    assert "speed: 0.7" in Path("parameters/planner.yaml").read_text()
    assert run(["check"], "rigel") == 0, capsys.readouterr().out


def test_the_image_sees_the_workspace_and_the_arguments(
    image: Callable[..., Any], workspace: Path, tmp_path: Path
) -> None:
    """A package of --package elsewhere, too."""
    other = tmp_path / "elsewhere"
    other.mkdir()
    requests = image()
    read_python(["rover_bringup", "rover.launch.py"], {"speed": "1"}, {"q": other}, "r:1")
    ((request, name, folders),) = requests
    assert request["file"] == [str(workspace / SAMPLE)]
    assert request["arguments"] == {"speed": "1"}
    assert (name, folders) == ("r:1", [other, workspace / "src"])


def test_a_package_that_is_not_here_is_the_images(image: Callable[..., Any]) -> None:
    requests = image()
    assert run(["import", "launch", "nav2_bringup", "bringup_launch.py", *IMAGE], "rigel") == 0
    assert requests[0][0]["file"] == ["nav2_bringup", "bringup_launch.py"]
    assert "namespace: nav2-bringup" in Path("Rigelfile").read_text()


def test_an_unknown_argument_is_an_error(image: Callable[..., Any]) -> None:
    image(processes=[make_process("p e")], arguments=["speed"])
    with pytest.raises(UserError, match='no argument "sped", did you mean "speed"'):
        read(Path(SAMPLE), {"sped": "1"}, {}, "r:1")


def test_an_included_file_is_evaluated_where_it_is_included(
    image: Callable[..., Any], workspace: Path
) -> None:
    """It gets the namespace, settings and arguments around it; without an image it stays a file."""
    requests = image(processes=[make_process("p e", "--ros-args", "-r", "__node:=n")])
    Path("src/a.launch.xml").write_text(
        """<launch><arg name="x" default="1"/><push_ros_namespace namespace="g"/>
        <set_remap from="c" to="d"/><set_parameter name="q" value="$(env Q 1)"/>
        <include file="$(find-pkg-share rover_bringup)/launch/rover.launch.py"/>
        <include file="$(find-pkg-share nav2)/b.launch.py"><arg name="y" value="2"/></include>
        </launch>"""
    )
    draft = read(Path("src/a.launch.xml"), {}, {}, "r:1")
    assert list(draft.nodes) == ["n", "n_2"]
    first, second = (request for request, _, _ in requests)
    assert first["file"] == [str(workspace / SAMPLE)]
    assert second["file"] == ["$(find-pkg-share nav2)/b.launch.py"]
    assert second["arguments"] == {"x": "1", "y": "2"}
    settings = {"env": {}, "parameters": {"q": "$(env Q 1)"}, "remappings": {"c": "d"}}
    assert first["around"] == {"namespace": "g", **settings}
    assert list(read(Path("src/a.launch.xml"), {}, {}).nodes) == ["rover", "b"]


def test_an_included_file_that_cannot_be_evaluated_stays_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without podman or docker the file around it is still read."""
    monkeypatch.setenv("PATH", "")
    include = '<include file="$(find-pkg-share nav2)/b.launch.py"/><include file="c.launch.py"/>'
    Path("src/a.launch.xml").write_text(f"<launch>{include}</launch>")
    draft = read(Path("src/a.launch.xml"), {}, {}, "r:1")
    assert draft.nodes == {"b": {"launch": {"package": "nav2", "file": "b.launch.py"}}}
    remarks = "\n".join(remark.message for remark in draft.remarks)
    assert "one pod: it was not evaluated: neither docker nor podman works here" in remarks
    assert "`include` is left out: it was not evaluated: neither" in remarks


@pytest.mark.parametrize(
    ("values", "file", "expected"),
    [
        (["-p", "a:=1"], "/**: {ros__parameters: {a: 2}}", {"a": 2}),
        (["-p", "a:=1"], "/g/*: {ros__parameters: {b.c: 2}}", {"a": 1, "b": {"c": 2}}),
        (["-p", "a:=[x,y]"], "/g: {n: {ros__parameters: {b: !!python/tuple [1, 2]}}}",
         {"a": ["x", "y"], "b": [1, 2]}),
        (["-p", "a:=x: y: z", "-p", "b:=True"], "", {"a": "x: y: z", "b": True}),
        (["-p", "m:a:=1"], "n: {ros__parameters: {}}", None),
        (["-p", "a:=''"], "/**: {ros__parameters: {x: 1}}\n/**: {ros__parameters: {y: 2}}",
         {"a": "", "x": 1, "y": 2}),
    ],
)  # fmt: skip
def test_parameters_are_those_that_rcl_takes(
    values: list[str], file: str, expected: Any, image: Callable[..., Any]
) -> None:
    """The last one of a name wins, of the parts of a file that are about the node."""
    line = ["--ros-args", "-r", "__node:=n", "-r", "__ns:=/g", *values, "--params-file", "/tmp/f"]
    draft = convert(image, "p e", *line, files={"/tmp/f": file})
    assert draft.nodes["g/n"].get("parameters") == expected
    kept = {"args": "--ros-args -p m:a:=1", "parameter_files": ["parameters/n.yaml"]}
    assert expected is not None or kept.items() <= draft.nodes["g/n"].items()


def test_a_file_of_the_image_or_of_a_package_stays_one(image: Callable[..., Any]) -> None:
    """A value that it replaces is left out, since values come last in a Rigelfile."""
    line = ["--ros-args", "-r", "__node:=n", "-p", "a:=1", "-p", "b:=2", "--params-file", "/etc/f"]
    draft = convert(image, "p e", *line, files={"/etc/f": "n: {ros__parameters: {a: 3}}"})
    assert draft.nodes["n"]["parameter_files"] == [{"image_file": "/etc/f"}]
    assert draft.nodes["n"]["parameters"] == {"b": 2}
    here = str(Path("src/rover_bringup/config/rover.yaml").resolve())
    line = ["--ros-args", "-r", "__node:=n", "--params-file", here]
    draft = convert(image, "p e", *line, files={here: "n: {ros__parameters: {a: 3}}"})
    kept = {"image_file": "$(find-pkg-share rover_bringup)/config/rover.yaml"}
    assert draft.nodes["n"]["parameter_files"] == [kept]
    with pytest.raises(UserError, match=r"a\.launch\.py:7: /etc/f is invalid YAML"):
        convert(image, "p e", "--ros-args", "--params-file", "/etc/f", files={"/etc/f": "n: ["})


@pytest.mark.parametrize(
    ("command", "changes", "message"),
    [
        (["p e", "--ros-args", "-r", "~/a:=b"], {}, "`~/a` needs the node's name"),
        (["p e", "/tmp/made.sdf"], {}, "what the launch file itself writes to /tmp/ is not"),
        (["p e"], {"lost": ["on_exit"]}, "`on_exit` is not carried over: Kubernetes starts"),
        (["nice", "p e"], {}, "`launch-prefix` is not carried over"),
        (["p e"], {"waiting": ["a timer"]}, "starts it after a timer; here it starts at once"),
        (["gzserver"], {}, "it is taken for a program without ROS"),
        (["ros2", "bag"], {}, "it has no fixed name"),
        (["p e", "--ros-args", "-p", "a:=[]"], {}, "the parameter `a` has no value"),
    ],
)
def test_what_is_not_carried_over_is_a_remark_with_its_line(
    command: list[str], changes: Any, message: str, image: Callable[..., Any]
) -> None:
    draft = convert(image, *command, **changes)
    remarks = [(remark.place.line, remark.node, remark.message) for remark in draft.remarks]
    assert any(line == 7 and node and message in text for line, node, text in remarks), remarks


def test_a_node_that_is_started_by_its_path_is_one(image: Callable[..., Any]) -> None:
    draft = convert(image, "/opt/x/drive", "-v", "--ros-args", "-r", "__node:=n", "-r", "a:=b")
    assert draft.nodes == {"n": {"args": "/opt/x/drive -v", "remappings": {"a": "b"}}}


def test_parameter_files_are_not_overwritten(
    image: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """As the Rigelfile; with --print none is written."""
    image()
    words = ["import", "launch", SAMPLE, *IMAGE]
    assert run([*words, "--print"], "rigel") == 0
    assert "not written with --print: parameters/planner.yaml" in capsys.readouterr().err
    assert not Path("parameters").exists()
    Path("parameters").mkdir()
    Path("parameters/planner.yaml").write_text("mine")
    assert run(words, "rigel") == 2
    assert not Path("Rigelfile").exists()
    assert run([*words, "--force"], "rigel") == 0
    assert "speed" in Path("parameters/planner.yaml").read_text()


# The container


def put_on_path(monkeypatch: pytest.MonkeyPatch, folder: Path, **programs: str) -> None:
    """Let PATH have these programs, and no other."""
    place = folder / "bin"
    place.mkdir()
    for name, script in programs.items():
        (place / name).write_text(f"#!/bin/sh\n{script}\n")
        (place / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(place))


@pytest.mark.programs
@pytest.mark.parametrize("broken", ["", "exit 1"])
def test_the_container_sees_the_workspace_and_no_network(
    broken: str, workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """docker is first if it works, as for builds; podman gets the full name of the image."""
    answer = "\n".join(["entrypoint prints", evaluator.BEGIN, json.dumps(EMPTY), evaluator.END])
    script = f"""[ $1 = version ] && exit 0
for word; do echo "$word" >> '{tmp_path}/words'; done
echo '{answer}'"""
    put_on_path(monkeypatch, tmp_path, docker=broken or script, podman=script)
    request = {"file": ["a.launch.py"], "arguments": {}}
    assert evaluate(request, "robot:1", [workspace, workspace / "src"]) == EMPTY
    words = (tmp_path / "words").read_text().splitlines()
    mount = f"type=bind,source={workspace},target={workspace},readonly"
    name = "docker.io/library/robot:1" if broken else "robot:1"
    options = ["--rm", "--network", "none", "--security-opt", "label=disable", "--mount", mount]
    assert words[: len(options) + 4] == ["run", *options, name, "python3", "-c"]
    assert json.loads(words[-1]) == request


@pytest.mark.programs
@pytest.mark.parametrize("programs", [{}, {"docker": "exit 1", "podman": "exit 1"}])
def test_without_podman_or_docker_it_is_refused(
    programs: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    put_on_path(monkeypatch, tmp_path, **programs)
    assert run(["import", "launch", SAMPLE, *IMAGE], "rigel") == 2
    error = capsys.readouterr().err
    assert "neither docker nor podman works here" in error
    assert "install podman" in error
    assert not Path("Rigelfile").exists()


def test_without_an_image_it_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """A launch file in Python is never guessed; one that does not exist is no other error."""
    assert run(["import", "launch", SAMPLE], "rigel") == 2
    error = capsys.readouterr().err
    assert "pass --image, or start it in one pod with a node" in error
    assert "launch: { package: rover_bringup, file: rover.launch.py }" in error
    assert run(["import", "launch", "no.launch.py", *IMAGE], "rigel") == 2
    assert "cannot read no.launch.py" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("message", "hint"),
    [
        ("SubstitutionFailure: launch configuration 'x' does not exist\nmore", "--arg NAME=VALUE"),
        ("PackageNotFoundError: 'package q'", "all packages that the file uses"),
    ],
)
def test_an_error_of_the_launch_file_is_the_users(message: str, hint: str) -> None:
    """It has the place, and what to do."""
    document = {"error": {"message": message, "place": [str(Path(SAMPLE).resolve()), 3]}}
    text = "\n".join([evaluator.BEGIN, json.dumps(document), evaluator.END])
    with pytest.raises(UserError) as error:
        read_output(Finished(0, text, "Traceback"), "r:1")
    assert error.value.message == f"{SAMPLE}:3: {message.splitlines()[0]}"
    assert error.value.details == tuple(message.splitlines()[1:])
    assert hint in (error.value.hint or "")


def test_a_container_that_does_not_answer_is_an_error_with_its_last_lines() -> None:
    done = Finished(127, f"{evaluator.BEGIN}\n{{", "exec: python3: not found")
    with pytest.raises(CommandFailed, match=r"r:1 did not evaluate .* \(exit code 127\)") as error:
        read_output(done, "r:1")
    assert error.value.details[-1] == "exec: python3: not found"
    assert "ENTRYPOINT" in (error.value.hint or "")

"""What a container runs: ROS' own arguments where they are read, parameters as they are meant."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
import yaml

from rigel_k8s.app.command import Command
from rigel_k8s.app.generations.ros1.commands import LOADER, command_of
from rigel_k8s.app.parameters import PARAMETERS_PATH

from .shapes import container, env, find, options, release


def command(node: str, files: dict[str, str] | None = None) -> Command:
    """Return what a node called `n` runs."""
    return command_of("n", options(f"{{image: a, nodes: {{n: {node}}}}}").nodes["n"], files or {})


@pytest.mark.parametrize(
    ("node", "args"),
    [
        ("{args: talker.py}", ["talker.py", "__name:=n"]),
        ("{args: [/opt/talker, -v]}", ["/opt/talker", "-v", "__name:=n"]),
        ("{args: talker.py, name: /a/talker}", ["talker.py", "__name:=talker"]),
        ("{args: talker.py, anonymous: true}", ["talker.py"]),
        ("{args: [bash, -c, 'exec x']}", ["bash", "-c", "exec x"]),
        ("{args: [/bin/sh, run.sh]}", ["/bin/sh", "run.sh"]),
        ("{args: [roslaunch, a, b.launch]}", ["roslaunch", "a", "b.launch"]),
        ("{args: [sleep, 1000]}", ["sleep", "1000"]),
        ("{package: p, executable: e, args: x}", ["rosrun", "p", "e", "x", "__name:=n"]),
        ("{launch: {file: /a.launch}}", ["roslaunch", "--wait", "/a.launch"]),
        (
            "{launch: {package: p, file: a.launch, args: {sim: true, n: 1}}}",
            ["roslaunch", "--wait", "p", "a.launch", "sim:=true", "n:=1"],
        ),
        ("{args: x, remappings: {a: /b}}", ["x", "__name:=n", "a:=/b"]),
        (
            "{args: x, parameters: {rate: 10, gain: 1.1, ~on: true, text: two words, a: {b: c}}}",
            [
                *("x", "__name:=n", "_rate:=10", "_gain:=1.1", "_on:=true"),
                *("_text:=two words", "_a/b:=c"),
            ],
        ),
        (
            "{args: x, anonymous: true, parameters: {list: [1, a], text: '10'}}",
            ["x", "_list:=[1, a]", "_text:='10'"],
        ),
    ],
)
def test_arguments_keep_the_entrypoint(node: str, args: list[str]) -> None:
    """The image's ENTRYPOINT sets up ROS, so everything stands in args."""
    assert command(node) == Command(args=args)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ("a $(find b c)/d", ["a", "$(find", "b", "c)/d"]),
        ("a --x=$(find b)/c '$(env D e f)'", ["a", "--x=$(find b)/c", "$(env D e f)"]),
        ('"$(find b)/c d"', ["$(find b)/c d"]),
    ],
)
def test_a_substitution_arg_stays_in_its_word(args: str, words: list[str]) -> None:
    """A text is split as a shell does it, but there is no space inside of an expression."""
    made = command(f"{{args: {args!r}, substitution_args: true}}")
    assert made.args is not None
    assert [*made.args] == [*words, "__name:=n"]


@pytest.mark.parametrize(
    "value", ["[1, 2]", "'10'", "'1e3'", "'yes'", "''", "'a: b'", "'0x10'", "'nan'"]
)
def test_what_a_command_line_cannot_carry_is_loaded_from_a_file(value: str) -> None:
    """roscpp makes text of a list, and both make a number of text that looks like one."""
    made = command(f"{{args: x, parameters: {{p: {value}, q: 1}}}}")
    assert made.args is not None
    assert [*made.args][3:] == ["/n", "x", "__name:=n"]
    loaded = yaml.safe_load(made.files["99-parameters.yaml"])
    assert loaded == {"p": yaml.safe_load(value), "q": 1}


def test_parameter_files_come_in_order_and_lose_to_parameters() -> None:
    """The last one wins in `rosparam load`, and the shell sorts by name."""
    files = {"config/b.yaml": "x: 1\n", "a.yaml": "x: 2\n"}
    made = command("{args: x, parameters: {x: 3}, parameter_files: [config/b.yaml, a.yaml]}", files)
    assert list(made.files) == ["00-b.yaml", "01-a.yaml", "99-parameters.yaml"]
    assert sorted(made.files) == list(made.files)


def test_changed_parameters_start_a_new_pod() -> None:
    """A ConfigMap's new content alone changes no pod; the template's annotation does."""
    text = "{image: a, nodes: {n: {args: x, parameter_files: [a.yaml]}}}"
    one, two, three = (
        find(release(text, files={"a.yaml": content}), "Deployment", "n")["spec"]["template"]
        for content in ("x: 1\n", "x: 2\n", "x: 1\n")
    )
    assert one["metadata"] != two["metadata"]
    assert one == three


@pytest.mark.programs
def test_the_loader_loads_all_files_then_becomes_the_program(tmp_path: Path) -> None:
    """In a real shell: each file, again until the master is there; then it is gone."""
    tools = tmp_path / "bin"
    tools.mkdir()
    log = tmp_path / "log"
    (tools / "sleep").write_text("#!/bin/sh\n")
    (tools / "rosparam").write_text(
        f'#!/bin/sh\necho "$@" >>{log}\n[ "$(wc -l <{log})" -gt 1 ] || exit 1\n'
    )
    for tool in tools.iterdir():
        tool.chmod(0o755)
    for name in ("00-a.yaml", "99-b.yaml"):
        (tmp_path / name).touch()
    script = LOADER.replace(PARAMETERS_PATH, str(tmp_path))
    line = ["/bin/sh", "-c", script, "/ns/n", "echo", "two words", "__name:=n"]
    done = subprocess.run(
        line, env={"PATH": f"{tools}:/usr/bin:/bin"}, capture_output=True, text=True, check=True
    )
    assert done.stdout == "two words __name:=n\n"
    first = f"load {tmp_path}/00-a.yaml /ns/n"
    assert log.read_text().splitlines() == [first, first, f"load {tmp_path}/99-b.yaml /ns/n"]


@pytest.mark.programs
def test_the_loader_says_what_is_missing(tmp_path: Path) -> None:
    """Without rosparam nothing is tried for ever."""
    done = subprocess.run(
        ["/bin/sh", "-c", LOADER, "/n", "echo"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 127
    assert "no rosparam" in done.stderr


def test_the_users_environment_wins() -> None:
    """Also over what every pod gets; ROS_HOSTNAME stands alone, since it beats ROS_IP in ROS."""
    text = (
        "{image: a, nodes: {n: {args: x, env: {ROS_HOSTNAME: h, PYTHONUNBUFFERED: '', V: 1.10}}}}"
    )
    made = release(text)
    found = env(made, "n")
    assert "ROS_IP" not in found
    assert (found["ROS_HOSTNAME"], found["PYTHONUNBUFFERED"], found["V"]) == ("h", "", "1.10")
    names = [e["name"] for e in container(made, "n")["env"]]
    assert len(names) == len(set(names))

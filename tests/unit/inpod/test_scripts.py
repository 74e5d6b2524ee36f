"""The mounted scripts as texts: complete, small, for old Pythons, and with their contracts."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType

import pytest

import rigel_inpod
from rigel_inpod import scripts
from rigel_rmw import libraries

ROOM = Path(rigel_inpod.__file__).parent
#: The exporter's: not mounted.
LOOK = ("spdp.py",)
#: All that runs in an application's container, below this folder.
PROGRAMS = {
    str(path.relative_to(ROOM)) for path in ROOM.rglob("*.py") if path.name != "__init__.py"
}


def test_every_script_is_mounted():
    """No file of the room is forgotten, and none has a name that a ConfigMap refuses."""
    on_disk = {path.name for path in ROOM.iterdir() if path.suffix in (".sh", ".py")}
    assert set(scripts()) == on_disk - {"__init__.py", *LOOK}
    assert all(re.fullmatch(r"[-._a-zA-Z0-9]+", name) for name in scripts())


def test_small():
    """With both libraries in base64 they stay far below a ConfigMap's limit of 1 MiB."""
    assert sum(len(text.encode()) for text in scripts().values()) < 240_000
    assert sum(map(len, libraries().values())) < 100_000


@pytest.mark.programs
@pytest.mark.parametrize("name", sorted(n for n in scripts() if n.endswith(".sh")))
@pytest.mark.parametrize("shell", ["sh", "dash", "bash"])
def test_shell_syntax(name: str, shell: str):
    """Each shell script is accepted by every shell that images have."""
    if not shutil.which(shell):
        pytest.skip(f"{shell} is not installed")
    done = subprocess.run([shell, "-n", str(ROOM / name)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


#: For ROS 2 and plain DDS, whose images have Python 3.
DDS = {
    *("components.py", "dds_local.py", "dds_ready.py", "handover.py", "interfaces.py", "keeper.py"),
    *("join.py", "lean.py", "rmw_notes.py", "rmw_ready.py", "rtps.py", "spdp.py", "transitions.py"),
    *("sent/notes.py", "sent/ros2_tools.py"),
}
#: Beside a lifecycle node only, whose image has them.
ROS2 = {"rclpy", "rclpy.executors", "lifecycle_msgs.srv"}
#: What a script needs besides: its image has it, and what runs once in a pod may load slowly.
MORE = {
    "blackbox.py": {"collections", "urllib.request", "urllib2"},
    "components.py": {"rclpy", "rclpy.parameter", "composition_interfaces.srv"},
    "globalparameters.py": {"hashlib", "json", "signal"},
    "join.py": {"json", "select", "threading"},
    "keeper.py": {"errno", "json", "select", "signal", "threading"},
    "lean.py": {"marshal"},
    "loading.py": {"json", "signal"},
    "nodelets.py": {"xmlrpc.client", "xmlrpclib"},
    "record.py": {"__future__", "json", "re", "shutil", "signal", "subprocess"},
    "roscore.py": {"roslaunch.config", "roslaunch.core", "roslaunch.launch", "runpy"},
    "start.py": {"json", "shlex", "subprocess", "tempfile"},
    "substitution.py": {"subprocess"},
    "rmw_notes.py": {"collections"},
    "transitions.py": ROS2 | {"signal"},
}


@pytest.mark.programs
@pytest.mark.parametrize("name", sorted(PROGRAMS - DDS))
def test_python2_syntax(name: str, tmp_path: Path, python2: str):
    """Each script for ROS 1 is compiled by Python 2.7, which ROS images up to melodic have."""
    compiled(python2, name, tmp_path)


@pytest.mark.programs
@pytest.mark.parametrize("name", sorted(DDS))
def test_python36_syntax(name: str, tmp_path: Path, python36: str):
    """Each script for DDS is compiled by Python 3.6, the oldest of a ROS 2 image."""
    compiled(python36, name, tmp_path)


def compiled(python: str, name: str, folder: Path) -> None:
    copy = folder / Path(name).name
    copy.write_text((ROOM / name).read_text())
    done = subprocess.run([python, "-m", "py_compile", str(copy)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_standard_library_only():
    """The Python scripts import one another and what every Python brings, nothing slow to load."""
    own = {name.removesuffix(".py") for name in scripts()}
    quick = {"os", "sys", "time", "_socket", "socket", "_thread", "thread", "struct", "fcntl"}
    for name, text in scripts().items():
        if name.endswith(".py") and name not in LOOK:
            assert imported(text) <= own | quick | MORE.get(name, set()), name


def test_what_is_not_mounted_needs_the_standard_library_only():
    """It may load slowly, but nothing has to be there."""
    own = {name.removesuffix(".py") for name in PROGRAMS}
    for name in LOOK:
        assert imported((ROOM / name).read_text()) <= own | sys.stdlib_module_names, name


def imported(text: str) -> set[str]:
    """The modules that a Python text imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:  # the exporter's way
            found.add(str(node.module))
    return found


def test_the_keeper_is_compiled_with_all_that_it_imports(script: Callable[[str], ModuleType]):
    """In an order in which each finds what it imports."""
    own, needed = {name.removesuffix(".py") for name in scripts()}, ["keeper"]
    for name in needed:
        text = scripts()[f"{name}.py"]
        needed += sorted(imported(text) & own - set(needed))
    order = script("lean").SCRIPTS
    assert set(order) == set(needed)
    for index, name in enumerate(order):
        assert imported(scripts()[f"{name}.py"]) & own <= set(order[:index]), name


@pytest.mark.programs
def test_the_keeper_runs_on_the_oldest_python(tmp_path: Path, python36: str):
    """Its child compiles it."""
    line = [python36, "-S", "-E", "-B", str(ROOM / "lean.py"), str(ROOM / "keeper.py"), "state"]
    done = subprocess.run(line, capture_output=True, text=True, env={"RIGEL_RMW": str(tmp_path)})
    assert (done.returncode, done.stdout, done.stderr) == (1, "has not started yet\n", "")


@pytest.mark.programs
def test_what_exec_starts_is_marked(script: Callable[[str], ModuleType]):
    """The readiness probe knows by it a tool that was left in the background."""
    done = subprocess.run(
        ["/bin/sh", str(ROOM / "exec.sh"), "env"],
        capture_output=True,
        text=True,
        env={"PATH": "/usr/bin:/bin"},
    )
    assert script("container").EXEC_MARK.decode() in done.stdout.splitlines()


@pytest.mark.programs
@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("/rigel-k8s/rmw-x86_64.so", None),
        ("/rigel-k8s/rmw-aarch64.so:/lib/own.so /lib/b.so", "/lib/own.so /lib/b.so"),
        ("/lib/own.so", "/lib/own.so"),
    ],
)
def test_what_exec_starts_has_no_layer(before: str, after: str | None):
    """It is for the node's own processes; a library of the user's stays."""
    longest = ":".join(f"/ws/{number}" for number in range(1000))  # other nodes may run here
    node = {"AMENT_PREFIX_PATH": longest, "LD_PRELOAD": before}
    with subprocess.Popen(["sleep", "60"], env=node, stderr=subprocess.DEVNULL) as sleep:
        done = subprocess.run(
            ["/bin/sh", "-c", f". {ROOM}/rc.sh; unset PATH; export -p"],
            capture_output=True,
            text=True,
            env={"PATH": "/usr/bin:/bin"},
        )
        sleep.kill()
    assert longest in done.stdout
    found = re.search(r"LD_PRELOAD='?\"?([^'\"\n]*)", done.stdout)
    assert (found and found[1]) == after


def test_contracts():
    """Each script's head says why it is there."""
    for name, text in scripts().items():
        assert re.search(r"^(# )?Why: ", text, re.MULTILINE), name


def test_the_house_has_a_map():
    """The package's docstring names every file of it, mounted or sent."""
    missing = [name for name in (*scripts(), *LOOK) if name not in (rigel_inpod.__doc__ or "")]
    assert not missing


@pytest.mark.programs
def test_a_shell_gets_the_longest_path_of_workspaces():
    """A workspace comes on top of its base."""
    base = ":".join(f"/opt/ros/{number}" for number in range(500))
    command = ["/bin/sh", "-c", f'. {ROOM}/rc.sh; echo "$AMENT_PREFIX_PATH"']
    with ExitStack() as cleanup:
        for path in (f"/ws:{base}", base):
            sleep = subprocess.Popen(["sleep", "60"], env={"AMENT_PREFIX_PATH": path})
            cleanup.callback(sleep.wait)
            cleanup.callback(sleep.kill)
        done = subprocess.run(
            command, capture_output=True, text=True, env={"PATH": "/usr/bin:/bin"}
        )
    assert done.stdout == f"/ws:{base}\n"

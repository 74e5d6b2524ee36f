"""The ROS 2 base image without building it: wheels, overlay, cache, and `ros2` without ROS."""

from __future__ import annotations

import hashlib
import os
import re
import signal
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from rigel_k8s.errors import CommandFailed, RigelK8sError
from rigel_lab.images.ros2base import REFERENCES, build, packages, recipe
from tests.support.recorder import Recorder

pytestmark = pytest.mark.programs

FILES = Path(recipe.__file__).parent / "files"
MMDEBSTRAP = """#!/bin/sh
printf '%s\\n' "$@" >"$LOG"
for word; do
  case $word in --customize-hook=tar-in*) tar=${word#*tar-in }; tar -tf "${tar% /}" >>"$LOG" ;; esac
  target=$word
done
mkdir "$target.d"; tar -C "$target.d" -cf "$target" .
"""
PIP = """#!/bin/sh
for word; do target=$word; done
cp "$WHEEL" "$target"
"""


def wheel(path: Path, **members: str) -> Path:
    """Write a wheel with these members."""
    with zipfile.ZipFile(path, "w") as out:
        for name, content in members.items():
            out.writestr(name, content)
    return path


def unpacked(*found: Path, target: Path) -> dict[str, tarfile.TarInfo]:
    recipe.write_tree(found, "opt/ros/jazzy", target, mtime=7)
    with tarfile.open(target) as tar:
        return {m.name.removeprefix("opt/ros/jazzy/"): m for m in tar.getmembers()}


def test_wheels_become_the_tree_of_the_official_image(tmp_path: Path) -> None:
    """Data goes below the prefix, bundled libraries to lib, modules where Python looks."""
    members = {
        "ros_a-1.data/data/share/a/package.xml": "<package/>",
        "ros_a-1.data/data/bin/fastdds": "#!/bin/sh",
        f"ros_a-1.data/data/{recipe.SITE}/a/__init__.py": "",
        "ros_a.libs/libssl-60250281.so.1.1.1k": "ssl",
        "ros_a-1.dist-info/METADATA": "Name: ros-a",
        "numpy.libs/libblas.so": "blas",
    }
    found = unpacked(wheel(tmp_path / "a.whl", **members), target=tmp_path / "t.tar")
    assert set(found) == {
        "share/a/package.xml",
        "bin/fastdds",
        f"{recipe.SITE}/a/__init__.py",
        "lib/libssl-60250281.so.1.1.1k",
        f"{recipe.SITE}/ros_a-1.dist-info/METADATA",
        f"{recipe.SITE}/numpy.libs/libblas.so",
    }
    assert found["bin/fastdds"].mode == 0o755
    assert {member.mtime for member in found.values()} == {7}


def test_what_only_compilers_read_is_left_out(tmp_path: Path) -> None:
    """Headers, CMake files, static libraries."""
    data = "ros_a-1.data/data"
    members = dict.fromkeys(
        (f"{data}/include/a/a.h", f"{data}/share/a/cmake/a.cmake", f"{data}/lib64/liba.a"), "x"
    )
    members["a/_dummy.cpython-311-x86_64-linux-gnu.so"] = "x"
    assert not unpacked(wheel(tmp_path / "a.whl", **members), target=tmp_path / "t.tar")


def test_a_librarys_shorter_names_are_links(tmp_path: Path) -> None:
    """A wheel cannot hold links: the same 15 MB would be there three times."""
    lib = "ros_a-1.data/data/lib"
    members = {f"{lib}/libx.so": "x", f"{lib}/libx.so.2": "x", f"{lib}/libx.so.2.1": "x"}
    members[f"{lib}/liby.so"] = "x"  # another library that is the same by chance
    found = unpacked(wheel(tmp_path / "a.whl", **members), target=tmp_path / "t.tar")
    links = {name: member.linkname for name, member in found.items() if member.issym()}
    assert links == {"lib/libx.so": "libx.so.2.1", "lib/libx.so.2": "libx.so.2.1"}
    assert found["lib/liby.so"].isfile()


def test_wheels_that_disagree_are_refused(tmp_path: Path) -> None:
    """One of two different libraries of one name would be taken by chance."""
    one = wheel(tmp_path / "one.whl", **{"ros_a.libs/libz.so": "1"})
    two = wheel(tmp_path / "two.whl", **{"ros_b.libs/libz.so": "2"})
    with pytest.raises(RigelK8sError, match=r"two\.whl and one\.whl .* lib/libz\.so") as failure:
        unpacked(one, two, target=tmp_path / "t.tar")
    assert failure.value.hint
    same = wheel(tmp_path / "same.whl", **{"ros_c.libs/libz.so": "1"})
    assert set(unpacked(one, same, target=tmp_path / "t.tar")) == {"lib/libz.so"}


@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_every_wheel_is_locked_with_digests(distro: packages.Distro) -> None:
    """What is downloaded is what was tried; nothing of what Debian has comes twice."""
    entries = re.split(r"\n(?=\S)", packages.lock(distro).strip())
    assert len(entries) > 60
    for entry in entries:
        assert re.match(r"[\w-]+==[\d.]+ \\\n( +--hash=sha256:[0-9a-f]{64}( \\\n)?)+$", entry)
    names = {entry.partition("==")[0] for entry in entries}
    assert {f"ros-{distro}-rclpy", f"ros-{distro}-rmw-fastrtps-cpp", "ros-std-msgs"} <= names
    assert not names & {"numpy", "pyyaml", "ros-wheels-bootstrapper"}


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH of programs that note how they were called; returns the note."""
    folder, log = tmp_path / "bin", tmp_path / "log"
    folder.mkdir()
    for name, text in (("mmdebstrap", MMDEBSTRAP), ("pip3", PIP)):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    monkeypatch.setenv("LOG", str(log))
    monkeypatch.setenv("WHEEL", str(wheel(tmp_path / "a.whl", **{"a/__init__.py": ""})))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "executable", "/bin/false")  # a Python without pip
    return log


def test_the_second_build_is_the_first_ones_file(programs: Path) -> None:
    """Wheels go into the root file system; another distribution is another archive."""
    first = build(Recorder())
    assert (first.built, first.reference) == (True, REFERENCES["jazzy"])
    told = programs.read_text()
    assert f"opt/ros/jazzy/{recipe.SITE}/a/__init__.py" in told
    assert "python3-numpy" in told
    assert "compileall" in told
    assert not build(Recorder()).built
    assert build(Recorder(), distro="kilted").archive != first.archive
    assert len(list(first.archive.parent.iterdir())) == 2


def test_other_wheels_are_another_image(programs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A renewed lock file is built, not overlooked in the cache."""
    first = build(Recorder())
    module = sys.modules["rigel_lab.images.ros2base.recipe"]
    monkeypatch.setattr(module, "lock", lambda distro: "ros-rclpy==9")
    assert build(Recorder()).archive != first.archive


def test_a_wheel_with_another_digest_or_none_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By pip itself."""
    found = tmp_path / "ros_demo-1-py3-none-any.whl"
    about = {"METADATA": "Metadata-Version: 2.1\nName: ros-demo\nVersion: 1\n", "RECORD": ""}
    about["WHEEL"] = "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    wheel(found, **{f"ros_demo-1.dist-info/{name}": text for name, text in about.items()})
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    digest = hashlib.sha256(found.read_bytes()).hexdigest()
    lock = "ros-demo==1 --hash=sha256:"
    fetched = recipe.fetch(f"{lock}{digest}", tmp_path / "right", Recorder())
    assert [path.name for path in fetched] == [found.name]
    for wrong in (f"{lock}{'0' * 64}", "ros-demo==1"):
        with pytest.raises(CommandFailed, match="downloading the wheels of ROS 2") as failure:
            recipe.fetch(wrong, tmp_path / "wrong", Recorder())
        assert "hashes" in "\n".join(failure.value.details).lower()


def test_without_pip_the_error_says_how_to_get_it(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Python of uv's has none."""
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(RigelK8sError, match="pip, which downloads") as failure:
        build(Recorder())
    assert "python3-pip" in str(failure.value.hint)


def test_other_processors_are_told_that_there_are_no_wheels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before anything is downloaded."""
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    with pytest.raises(RigelK8sError, match="no wheels of ROS 2 for arm64"):
        build(Recorder())


@pytest.mark.parametrize("shell", ["sh", "bash"])
def test_setup_twice_is_setup_once(tmp_path: Path, shell: str) -> None:
    """Sourced once or twice, with -eu, behind a workspace's paths: the same environment."""
    setup = tmp_path / "setup.sh"
    text = {e.path: e.content for e in recipe.list_files("jazzy")}["opt/ros/jazzy/setup.sh"]
    setup.write_bytes(text)
    names = "AMENT_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH ROS_DISTRO ROS_VERSION"
    script = f"set -eu; . {setup}; . {setup}; for n in {names}; do eval echo \\$$n; done"
    env = {"PATH": "/usr/bin:/bin", "LD_LIBRARY_PATH": "/mine"}
    done = subprocess.run([shell, "-c", script], capture_output=True, text=True, env=env)
    assert (done.stdout.splitlines(), done.stderr) == (
        [
            "/opt/ros/jazzy",
            "/opt/ros/jazzy/lib:/mine",
            f"/opt/ros/jazzy/{recipe.SITE}",
            "jazzy",
            "2",
        ],
        "",
    )


def test_the_layer_has_what_the_official_image_has() -> None:
    """The entry point and `ros2` are executable, whatever this checkout says."""
    found = {entry.path: entry for entry in recipe.list_files("kilted")}
    assert found["ros_entrypoint.sh"].mode == 0o755
    assert found["opt/ros/kilted/bin/ros2"].mode == 0o755
    assert b"/opt/ros/kilted/share/rigel_ros2" in found["opt/ros/kilted/bin/ros2"].content
    assert "opt/ros/kilted/share/rigel_ros2/__main__.py" in found
    assert all(b"@DISTRO@" not in entry.content for entry in found.values())


@pytest.fixture
def package(tmp_path: Path) -> dict[str, str]:
    """An environment with a package `demo` that has a program `count.sh`."""
    (tmp_path / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (tmp_path / "share/ament_index/resource_index/packages/demo").touch()
    (tmp_path / "share/demo").mkdir()
    program = tmp_path / "lib/demo/count.sh"
    program.parent.mkdir(parents=True)
    program.write_text('#!/bin/sh\ntrap "echo interrupted; exit" INT\necho "$$ $*"\n$WAIT & wait\n')
    program.chmod(0o755)
    return {**os.environ, "AMENT_PREFIX_PATH": str(tmp_path), "WAIT": "true"}


def ros2(*words: str, env: dict[str, str]) -> subprocess.Popen[str]:
    command = [sys.executable, str(FILES / "ros2"), *words]
    return subprocess.Popen(command, env=env, stdout=-1, stderr=-1, text=True)


def test_ros2_run_becomes_the_program(package: dict[str, str]) -> None:
    """Its process is the caller's: a signal to process 1 of a container reaches the node."""
    process = ros2("run", "demo", "count.sh", "--ros-args", "-p", "a:=1", env=package)
    assert process.communicate()[0] == f"{process.pid} --ros-args -p a:=1\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("run", "nope", "x"), "Package 'nope' not found"),
        (("run", "demo", "x"), "No executable found: 'x' of package 'demo' (it has: count.sh)"),
        (("run", "demo"), "usage: ros2 run PACKAGE EXECUTABLE"),
        (("launch", "nope.xml"), "nope.xml: the file does not exist"),
        (("launch", "demo", "x.xml"), "package 'demo' has no file named 'x.xml'"),
    ],
)
def test_ros2_tells_what_is_not_there(
    package: dict[str, str], words: tuple[str, ...], told: str
) -> None:
    """What is meant, and what there is instead; no traceback."""
    process = ros2(*words, env=package)
    error = process.communicate()[1]
    assert process.returncode == 1
    assert error.startswith(told)
    assert "Traceback" not in error


LAUNCH = """\
<launch>
  <arg name="who"/>
  <arg name="rate" default="5"/>
  <node pkg="demo" exec="count.sh" name="$(var who)" args="a b">
    <param name="rate" value="$(var rate)"/>
    <param from="/rates.yaml"/>
    <remap from="chatter" to="/chatter"/>
  </node>
  <node pkg="demo" exec="count.sh"/>
</launch>
"""


def test_ros2_launch_starts_what_an_xml_file_says(package: dict[str, str], tmp_path: Path) -> None:
    """Names, parameters and remappings; each line with its node's name."""
    (tmp_path / "share/demo/all.launch.xml").write_text(LAUNCH)
    out, err = ros2("launch", "demo", "all.launch.xml", "who:=me", env=package).communicate()
    lines = [re.sub(r"\d{2,}", "PID", line) for line in out.splitlines()]
    ros = "-r __node:=me -p rate:=5 --params-file /rates.yaml -r chatter:=/chatter"
    assert f"[me-1] PID a b --ros-args {ros}" in lines
    assert "[count.sh-2] PID " in [f"{line} ".replace("  ", " ") for line in lines]
    assert err == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ros2_launch_asks_its_nodes_to_stop(
    package: dict[str, str], tmp_path: Path, number: signal.Signals
) -> None:
    """As process 1 it gets SIGTERM: its nodes get SIGINT, which ROS knows, and it ends with 0."""
    (tmp_path / "one.xml").write_text('<launch><node pkg="demo" exec="count.sh"/></launch>')
    process = ros2("launch", str(tmp_path / "one.xml"), env={**package, "WAIT": "sleep 9"})
    assert process.stdout
    for line in process.stdout:
        if line.startswith("[count.sh-1]"):
            break
    process.send_signal(number)
    rest = process.communicate(timeout=120)[0]
    assert "[INFO] [count.sh-1]: sending signal 'SIGINT'" in rest
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('<launch><arg name="x"/></launch>', "the argument x has no default: add x:=VALUE"),
        ("<launch><timer/></launch>", "does not support <timer>"),
        ('<launch><node pkg="demo"/></launch>', "<node> has no exec="),
        ('<launch><node pkg="$(nope)" exec="x"/></launch>', "$(nope) is not supported here"),
        ('<launch><node pkg="demo" exec="x" if="1"/></launch>', "does not support if= of <node>"),
    ],
)
def test_ros2_launch_passes_nothing_over(
    package: dict[str, str], tmp_path: Path, text: str, told: str
) -> None:
    """What it cannot do is an error with the file's name, before anything is started."""
    (tmp_path / "one.xml").write_text(text)
    out, err = ros2("launch", str(tmp_path / "one.xml"), env=package).communicate()
    assert told in err
    assert str(tmp_path / "one.xml") in err
    assert out == ""

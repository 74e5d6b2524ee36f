"""The wheel: every file of the package is in it, and it works where there is no checkout."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder

from hatch_build import HOME, STAMP, build, compile_layer
from hatch_build import SOURCES as LAYER

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "src"
#: One of each kind of data that something reads at run time.
DATA = (
    "rigel_stack/boards/files/rigel-logs.json",
    "rigel_stack/boards/files/rigel-platform.yaml",
    "rigel_exporter/__main__.py",
    "rigel_lab/images/base/files/ros_entrypoint.sh",
    "rigel_lab/images/mutoagent/files/wheels.txt",
    "rigel_lab/images/ros1base/files/setup.zsh",
    "rigel_lab/images/ros2base/files/jazzy.in",
    "rigel_lab/images/ros2base/files/jazzy.txt",
    "rigel_lab/images/ros2base/files/ros2/__main__.py",
    "rigel_inpod/ready.sh",
    "rigel_rmw/lib/rmw-aarch64.so",
    "rigel_rmw/lib/rmw-x86_64.so",
    "rigel_lab/cluster/install-cnis.sh",
    "rigel_lab/cluster/lock/multus/go.mod",
    "rigel_lab/cluster/lock/multus/go.sum",
    "rigel_multus/crds/k8s.cni.cncf.io_network-attachment-definitions.yaml",
    "rigel_multus/machine.sh",
    "rigel_k8s/network/interface.sh",
    "rigel_ui/page/index.html",
    "rigel_ui/page/app.js",
    "rigel_ui/page/lib/viz.js",
    "rigel_ui/page/lib/NOTICE",
    "rigel_k8s/py.typed",
)
READS = """
import rigel_inpod as inpod
from rigel_stack import boards
from rigel_lab.images.exporter import entries as exporter
from rigel_lab.images.mutoagent import list_package, read_lock
from rigel_lab.images.ros1base.recipe import list_files as ros1
from rigel_lab.images.ros2base.recipe import list_files as ros2
from rigel_lab.images.ros2base.packages import lock
from rigel_k8s.network.files import interface_script
from rigel_rmw import libraries
from rigel_multus.manifests import DEFINITIONS, machine_script, read, read_definitions
assert all(inpod.scripts().values()) and boards.dashboards() and boards.rules()
assert exporter() and ros1("core") and ros2("jazzy") and lock("jazzy") and lock("kilted")
assert list_package() and read_lock()
assert interface_script() and machine_script()
assert list(libraries()) == ["rmw-x86_64.so", "rmw-aarch64.so"]
assert read_definitions(DEFINITIONS) and read("files", "multus-rights")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel as the build backend makes it from this checkout."""
    directory = tmp_path_factory.mktemp("wheel")
    [made] = WheelBuilder(str(ROOT)).build(directory=str(directory), versions=["standard"])
    return Path(made)


def test_one_wheel_is_for_all_platforms(wheel: Path) -> None:
    """It contains compiled libraries, but nothing that the installing machine runs."""
    assert wheel.name.endswith("-py3-none-any.whl")


@pytest.mark.programs
def test_the_layer_is_the_same_from_any_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its bytes depend on sources and compiler alone, and are for the machine that they name."""
    assert build()
    for name in LAYER:
        shutil.copy(HOME / name, tmp_path)
    monkeypatch.setattr("hatch_build.HOME", tmp_path)
    monkeypatch.setattr("hatch_build.LIBRARIES", tmp_path)
    for machine, number in (("x86_64", 62), ("aarch64", 183)):  # of ELF
        compile_layer(machine)
        made = (tmp_path / f"rmw-{machine}.so").read_bytes()
        assert made == (HOME / f"lib/rmw-{machine}.so").read_bytes()
        assert int.from_bytes(made[18:20], "little") == number
        wanted = [tuple(map(int, one.split(b"."))) for one in re.findall(rb"GLIBC_([\d.]+)", made)]
        assert wanted
        assert max(wanted) <= (2, 17)


def test_without_a_compiler_the_package_is_built_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """`rigel` works without the library; the build says so instead of failing."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert not build()


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """A directory that the wheel was unpacked into, as an installation does."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(wheel.parent / "installed")
    return wheel.parent / "installed"


def python(installed: Path, where: Path, code: str, *words: str) -> str:
    """Return what a Python prints that has the package from the wheel alone."""
    own = "import rigel_k8s, sys; assert rigel_k8s.__file__.startswith(sys.argv.pop(1))"
    command = [sys.executable, "-c", f"{own}\n{code}", str(installed), *words]
    variables = {**os.environ, "PYTHONPATH": str(installed)}
    done = subprocess.run(
        command, check=False, cwd=where, env=variables, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_file_of_the_package_is_in_the_wheel(wheel: Path) -> None:
    """What a pattern of .gitignore or of the build leaves out is missed on a user's machine."""
    ours = {
        path.relative_to(SOURCES).as_posix()
        for path in SOURCES.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.name != STAMP
    }
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if not name.split("/")[0].endswith("-info")}
    assert packed == ours
    assert set(DATA) <= packed


@pytest.mark.programs
def test_the_wheel_works_without_the_checkout(installed: Path, tmp_path: Path) -> None:
    """A Rigelfile is begun and checked, and the schema printed."""
    main = "import runpy; runpy.run_module('rigel_k8s', run_name='__main__')"
    python(installed, tmp_path, main, "init")
    assert "no problems" in python(installed, tmp_path, main, "check")
    assert '"$schema"' in python(installed, tmp_path, main, "schema")


@pytest.mark.programs
def test_what_is_read_at_run_time_is_in_the_wheel(installed: Path, tmp_path: Path) -> None:
    """Scripts, boards, and what images are made of."""
    python(installed, tmp_path, READS)

"""The image of Muto's agent: the whole package, with the wheels of the lock files."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from packaging.markers import Marker

from rigel_k8s import __version__
from rigel_lab.images.base.program import PREFIX
from rigel_lab.images.mutoagent import UPSTREAM, list_package, list_wheels, read_lock
from rigel_muto.agent.manifests import AGENT_IMAGE

ROOT = Path(__file__).parents[4]


def read_pins(text: str) -> dict[str, str]:
    """Return the versions of a lock file for Python 3.11."""
    found = re.findall(r"^([\w-]+)==(\S+)(?: ; (.*))? \\$", text, re.M)
    python = {"python_version": "3.11", "python_full_version": "3.11.0"}
    return {
        name: version
        for name, version, when in found
        if not when or Marker(when).evaluate({**python, "sys_platform": "linux"})
    }


def test_pods_ask_for_the_image_that_is_built() -> None:
    assert AGENT_IMAGE == UPSTREAM


def test_the_wheels_are_those_that_the_tests_run_with() -> None:
    """And paho-mqtt beside them."""
    run = read_pins((ROOT / "requirements" / "run.txt").read_text("utf-8"))
    own = read_pins(read_lock())
    assert re.fullmatch(r"2\.\d+\.\d+", own.pop("paho-mqtt"))
    assert own == run


@pytest.mark.programs
def test_the_package_in_the_image_runs(tmp_path: Path) -> None:
    """Alone, without rigel_lab: nothing that the agent imports is left out."""
    entries = list_package()
    for entry in entries:
        path = tmp_path / entry.path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(entry.content)
    environ = {**os.environ, "PYTHONPATH": str(tmp_path / PREFIX)}
    code = (
        "import rigel_k8s.jobs.types.orchestration, rigel_muto.cli, rigel_k8s;"
        "import rigel_k8s.app.deploying.prepare, rigel_multus.install, rigel_stack.install;"
        "import rigel_graph.hooks, rigel_graph.reading, rigel_graph.watching;"
        "from rigel_k8s.app.deploying.guests import load_guests; assert load_guests();"
        "from rigel_k8s.cli.main import list_all_commands; list_all_commands();"
        "import sys; ours = [m for n, m in sys.modules.items() if n.startswith('rigel_')];"
        "assert all(m.__file__.startswith(sys.argv[1]) for m in ours), ours;"
        "print(rigel_k8s.__version__, rigel_k8s.__file__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        env=environ,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.stdout.split() == [__version__, str(tmp_path / PREFIX / "rigel_k8s/__init__.py")]
    assert not any("__pycache__" in entry.path for entry in entries)


def test_a_wheel_is_unpacked_without_its_scripts(tmp_path: Path) -> None:
    wheel = tmp_path / "a-1.whl"
    with zipfile.ZipFile(wheel, "w") as made:
        made.writestr("a/__init__.py", "1")
        made.writestr("a-1.data/scripts/a", "2")
        made.writestr("a-1.dist-info/METADATA", "3")
    found = [(entry.path, entry.content) for entry in list_wheels([wheel])]
    assert found == [
        (f"{PREFIX}/a/__init__.py", b"1"),
        (f"{PREFIX}/a-1.dist-info/METADATA", b"3"),
    ]

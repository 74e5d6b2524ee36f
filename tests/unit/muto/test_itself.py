"""docs/muto-itself.md and examples/muto-itself: Muto's own programs as an application."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from rigel_k8s.commands import rigelfiles
from rigel_k8s.commands.targets import job_of
from rigel_k8s.settings import Settings

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "muto-itself.md").read_text("utf-8")
EXAMPLE = ROOT / "examples" / "muto-itself"
AGENT_PAGE = (ROOT / "docs" / "muto-agent.md").read_text("utf-8")
#: The rows that compare Muto's behaviour with ours.
COMPARED = [
    row
    for page in (PAGE, AGENT_PAGE)
    for row in re.findall(r"^\| .* \|$", page.partition("| shown by |\n")[2], re.M)
]
#: Muto reads its parameters below these names.
FIXED = {"muto_agent", "muto_composer", "composer_plugin", "launch_plugin"}


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set what the Rigelfiles take from the environment."""
    monkeypatch.setenv("REGISTRY", "localhost:5000")
    monkeypatch.setenv("BASE_IMAGE", "localhost:5000/ros:noetic")
    monkeypatch.setenv("TWIN_URL", "http://ditto:ditto@ditto")


@pytest.mark.parametrize("generation", ["ros1", "ros2"])
def test_the_example_is_clean(generation: str) -> None:
    """It passes `rigel check` without the sources, and builds before it deploys."""
    settings = Settings(rigelfile=EXAMPLE / generation / "Rigelfile")
    assert rigelfiles.check(settings).render_findings() == []
    assert list(rigelfiles.load(settings).jobs) == ["dockerfile", "build", "deploy"]
    broker = job_of(settings, None).options.nodes["mosquitto"]
    assert (broker.ros, [port.port for port in broker.ports]) == ("none", [1883])


def test_ros_1_has_all_four_programs_with_one_configuration() -> None:
    """Under the names that they must have, each gone before its successor starts."""
    settings = Settings(rigelfile=EXAMPLE / "ros1" / "Rigelfile")
    nodes = job_of(settings, None).options.nodes
    programs = {str(key): node for key, node in nodes.items() if node.ros != "none"}
    assert set(programs) == FIXED
    assert {tuple(node.parameter_files) for node in programs.values()} == {("muto.yaml",)}
    assert {node.update.strategy for node in programs.values()} == {"Recreate"}
    patched = programs["launch_plugin"].patch["spec"]["template"]["spec"]
    assert patched == {"shareProcessNamespace": True}
    muto = yaml.safe_load((EXAMPLE / "ros1" / "muto.yaml").read_text())["muto"]
    assert {pipeline["name"] for pipeline in muto["pipelines"]} == {"start", "apply", "kill"}
    assert (muto["mqtt"]["host"], muto["mqtt"]["port"]) == ("mosquitto", 1883)


def test_ros_2_launches_what_its_image_has() -> None:
    """The launch file of the clone, where the Dockerfile job copies it."""
    settings = Settings(rigelfile=EXAMPLE / "ros2" / "Rigelfile")
    target = job_of(settings, None)
    launch = target.options.nodes["muto"].launch
    place = f"/home/rigeluser/ros_workspace/src/{target.context.application.dir.name}"
    assert launch.file == f"{place}/launch/muto.launch.py"


@pytest.mark.parametrize("row", COMPARED)
def test_each_promise_names_a_test(row: str) -> None:
    """That test exists."""
    shown = row.split("|")[-2].strip()
    tests = re.findall(r"`([\w/]+\.py)::(\w+)`", shown)
    assert tests
    for path, name in tests:
        file = path if "/" in path else f"tests/unit/muto/agent/{path}"
        assert f"def {name}(" in (ROOT / file).read_text("utf-8")

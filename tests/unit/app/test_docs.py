"""Every YAML block of the documents about this room is a job's `with` that works."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.app.files import LocalFile
from rigel_k8s.jobs import registry
from rigel_k8s.rigelfile import check_file
from tests.support.podsecurity import list_missing

from .shapes import env, find, pod, problems, release

DOCS = Path(__file__).parents[3] / "docs"
FILES = {"config/planner.yaml": "speed: 1\n"}
FOLDERS = {
    "maps/": {"lab.yaml": LocalFile(b"resolution: 0.05\n")},
    "config/layout.json": {"": LocalFile(b"{}")},
}
#: Which documents, and the distribution that they write for.
ABOUT = {
    "ros1.md": "noetic",
    "nodes.md": "noetic",
    "ros1-updates.md": "noetic",
    "placement.md": "noetic",
    "rigel.md": "noetic",
    "ros2.md": "jazzy",
    "ros2-updates.md": "jazzy",
    "security.md": "noetic",
    "see.md": "jazzy",
}
#: Warnings that an example of ours never deserves.
SURPRISES = ("own-name", "two-at-once")


def blocks() -> Iterator[object]:
    """Yield each block with where it stands."""
    for name, distro in ABOUT.items():
        text = (DOCS / name).read_text("utf-8")
        for found in re.finditer(r"^```yaml\n(.*?)^```", text, re.M | re.S):
            if found[1].startswith("jobs:"):
                continue
            line = text[: found.start()].count("\n") + 2
            own = "jazzy" if found[1].startswith('ros: "2"') else distro
            yield pytest.param(found[1], own, id=f"{name}:{line}")


@pytest.mark.parametrize(("text", "distro"), list(blocks()))
def test_documented_options_work(text: str, distro: str) -> None:
    """They pass the check, become objects, and have the names and updates that they seem to."""
    found = problems(text, distro)
    assert [p for p in found if p.severity == "error" or p.kind in SURPRISES] == []
    assert release(text, distro=distro, files=FILES, folders=FOLDERS).objects


def find_type(kind: str, name: str) -> Any:
    """Return one of this package's own job types or providers."""
    return registry.job_type(name) if kind == "job" else registry.provider_type(name)


def test_an_unrestricted_driver_of_ros2_meets_a_restricted_application(tmp_path: Path) -> None:
    """The Rigelfile of docs/security.md: one domain, and the driver looks for the planner."""
    text = (DOCS / "security.md").read_text("utf-8")
    (shown,) = re.findall(r'^```yaml title="Rigelfile"\n(.*?)^```', text, re.M | re.S)
    (tmp_path / "Rigelfile").write_text(shown)
    assert check_file(tmp_path / "Rigelfile", {}, find_type).render_findings() == []
    jobs = yaml.safe_load(shown)["jobs"]
    robot, drivers = (
        release(yaml.safe_dump(jobs[name]["with"]), distro="jazzy") for name in ("robot", "drivers")
    )
    assert list_missing(pod(robot, "planner")) == []
    assert list_missing(pod(drivers, "camera")) != []
    domains = {
        env(made, name)["ROS_DOMAIN_ID"] for made, name in ((robot, "planner"), (drivers, "camera"))
    }
    assert domains == {"7"}
    (peer,) = jobs["drivers"]["with"]["network"]["peers"]
    name, space = peer.split(".")
    assert find(robot, "Service", name)
    assert space == jobs["robot"]["with"]["namespace"]
    assert peer in find(drivers, "ConfigMap", "drivers-network")["data"]["peers"].split(";")

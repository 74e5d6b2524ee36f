"""Nodes on several middlewares, in one image: what tests of modes and interoperation share."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef

from ....support.ros2base import push_ros2
from ....support.rust import Missing, rustdds_node
from ..conftest import projects

IMAGES = Path(__file__).parents[3] / "images"
SCRIPTS = Path(__file__).parents[4] / "examples/ros2-talker-listener/talker_listener/scripts"
HEARD = re.compile(r"I heard hello world from (\w+): \S+ (\d+)")


def wheels(requirements: Path, target: Path) -> None:
    """Unpack wheels for the image's Python, Debian 12's, whatever this one is."""
    words = ["download", "--quiet", "--no-deps", "--require-hashes", "--only-binary=:all:"]
    words += ["--python-version", "3.11", "--platform", "manylinux_2_17_x86_64"]
    fetched = target.with_name("fetched")
    words += ["--requirement", str(requirements), "--dest", str(fetched)]
    done = subprocess.run(
        [sys.executable, "-m", "pip", *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    for wheel in fetched.glob("*.whl"):
        with zipfile.ZipFile(wheel) as opened:
            opened.extractall(target)


def build(registry: str, base: str, context: Path, tag: str) -> str:
    """Build tests/images/interop on a base image, push it, and return its name."""
    shutil.copytree(IMAGES / "interop", context)
    try:
        shutil.copy2(rustdds_node(), context / "rustdds-node")
    except Missing as missing:
        pytest.skip(str(missing))
    for script in SCRIPTS.iterdir():
        shutil.copy2(script, context / "nodes")
    wheels(context / "requirements.txt", context / "wheels")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "rigel_k8s",
            "-f",
            str(context / "Rigelfile"),
            "run",
            "job",
            "build",
        ],
        env={**os.environ, "REGISTRY": registry, "BASE_IMAGE": base, "TAG": tag},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return f"{registry}/rigel-test-interop:{tag}"


@pytest.fixture(scope="session")
def interop_image(registry: str, ros2_image: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The image of tests/images/interop in the cluster's registry, on jazzy."""
    return build(registry, ros2_image, tmp_path_factory.mktemp("interop") / "jazzy", "jazzy")


@pytest.fixture(scope="session")
def kilted_image(registry: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The same on kilted, whose Fast DDS is 3."""
    base = f"{registry}/ros:kilted"
    push_ros2(base, "kilted")
    return build(registry, base, tmp_path_factory.mktemp("interop") / "kilted", "kilted")


@attrs.frozen
class Release:
    """A deployed release: its project, and what its nodes log."""

    project: Any

    def heard(self, node: str, *, since: int | None = 3) -> set[str]:
        """Return whom a listener has heard in these last seconds."""
        pod = self.project.pods().get(node.replace("_", "-"))
        if pod is None:
            return set()
        lines = self.project.cluster.logs(
            self.project.space, pod["metadata"]["name"], since_seconds=since
        )
        return {match[1] for match in map(HEARD.search, lines) if match}

    def until_heard(self, node: str, whom: set[str], *, seconds: float = 120) -> None:
        """Wait until a listener hears exactly these."""
        self.project.until(
            lambda: self.heard(node) == whom,
            f"{whom} at {node}, which hears {self.heard(node)},",
            seconds=seconds,
        )

    def address(self, workload: str) -> str:
        """Return the address of a workload's pod."""
        return str(self.project.pods()[workload]["status"]["podIP"])

    def move(self, workload: str) -> None:
        """Have a workload's pod ended, and a new one started on another machine."""
        cluster, space = self.project.cluster, self.project.space
        machines = self.project.machines()
        apart = {"talker-1", "listener"}
        taken = {machines[name] for name in {workload} | (apart if workload in apart else set())}
        names = {node["metadata"]["name"] for node in cluster.list("v1", "Node")}
        other = min(names - taken)
        pod = {"nodeSelector": {"kubernetes.io/hostname": other}}
        ref = ObjectRef("apps/v1", "Deployment", space, workload)
        cluster.patch(ref, {"spec": {"template": {"spec": pod}}})
        pod_there = f"pod of {workload} on {other}"  # perhaps after its image
        self.project.until(lambda: self.is_ready(workload, other), pod_there, seconds=240)

    def is_ready(self, workload: str, machine: str) -> bool:
        """Return whether a workload's pod is ready on a machine."""
        pod = self.project.pods().get(workload, {"spec": {}, "status": {}})
        ready = {"type": "Ready", "status": "True"}
        told = [{key: one[key] for key in ready} for one in pod["status"].get("conditions", ())]
        return pod["spec"].get("nodeName") == machine and ready in told


@pytest.fixture(scope="class")
def deployed(
    cluster: Any,
    context: str,
    registry: str,
    interop_image: str,
    ros2_image: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[..., Release]]:
    """Deploy tests/images/interop with other options: deployed(network=..., nodes=...).

    What a class of tests has deployed goes with it: idle nodes and their probes use a processor.
    """
    with projects(cluster, context, registry, tmp_path_factory.mktemp("modes")) as project:
        yield deployer(project, ros2_image)


def deployer(project: Callable[..., Any], ros2_image: str) -> Callable[..., Release]:
    """Return what deploys, by what makes projects."""

    def deploy(distro: str = "jazzy", **options: Any) -> Release:
        made = project("../tests/images/interop", ros2_image, lambda job: job.update(options))
        written = yaml.safe_load(made.rigelfile.read_text())
        written["application"]["distro"] = distro
        if options.get("ros") == "none":  # such an application says itself in which domain it is
            written["jobs"]["deploy"]["with"]["network"].pop("domain_id", None)
        made.rigelfile.write_text(yaml.safe_dump(written, sort_keys=False))
        made = attrs.evolve(made, env={**made.env, "TAG": distro})
        made("run", "job", "deploy")
        return Release(made)

    return deploy

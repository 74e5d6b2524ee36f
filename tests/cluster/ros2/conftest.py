"""An example's Rigelfile, perhaps changed, in a namespace of its own: what tests of ROS 2 share."""

from __future__ import annotations

import itertools
import json
import os
import random
import re
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from ipaddress import IPv4Network
from pathlib import Path
from typing import Any

import attrs
import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef
from tests.support import shared
from tests.support.ros2_work import image
from tests.support.ros2base import push_ros2
from tests.support.until import until

from .. import machines

EXAMPLES = Path(__file__).parents[3] / "examples"
HEARD = re.compile(r"I heard hello world from (\w+): \S+ (\d+)")
STATUS = "k8s.v1.cni.cncf.io/network-status"

#: Switches an interface; no image has to have `ip` for it.
LINK = """
import fcntl, socket, struct, sys
name, up = sys.argv[1].encode(), sys.argv[2] == "up"
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
    asked = fcntl.ioctl(any_socket, 0x8913, struct.pack("16sh", name, 0))
    flags = struct.unpack("16sh", asked)[1]
    fcntl.ioctl(any_socket, 0x8914, struct.pack("16sh", name, flags | 1 if up else flags & ~1))
"""

#: One after the other: a namespace that is being deleted may still have its nodes.
DOMAINS = itertools.cycle(range(6))
Change = Callable[[dict[str, Any]], None]
Make = Callable[..., "Project"]


def rigel(*words: str, check: bool = True, **env: str) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own, as a user does; a failure shows its output."""
    done = subprocess.run(
        [sys.executable, "-m", "rigel_k8s", *words],
        env={**os.environ, **env},
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0 or not check, done.stdout + done.stderr
    return done


def wait_until(done: Callable[[], Any], what: str, *, seconds: float = 120) -> None:
    """Wait until something is done."""
    until(done, what, seconds, every=0.3)


@attrs.frozen
class Project:
    """An example, deployed in a namespace of its own."""

    cluster: Any
    context: str
    space: str
    rigelfile: Path
    env: Mapping[str, str]

    def __call__(self, *words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        return rigel(*self.place, *words, check=check, **self.env)

    @property
    def place(self) -> tuple[str, ...]:
        """The options that name its Rigelfile and its cluster."""
        return ("-f", str(self.rigelfile), "--context", self.context, "-n", self.space)

    def command(self, *words: str) -> list[str]:
        """Return the line of a command that goes on."""
        variables = [f"{name}={value}" for name, value in self.env.items()]
        return ["env", *variables, sys.executable, "-m", "rigel_k8s", *self.place, *words]

    @property
    def subnet(self) -> IPv4Network:
        """The range of the second network."""
        jobs = yaml.safe_load(self.rigelfile.read_text())["jobs"]
        return IPv4Network(jobs["deploy"]["with"]["network"]["subnet"])

    until = staticmethod(wait_until)

    def pods(self) -> dict[str, dict[str, Any]]:
        """Return the pods that are not ending, by their workload."""
        return {
            pod["metadata"]["labels"]["app.kubernetes.io/name"]: pod
            for pod in self.cluster.list("v1", "Pod", self.space)
            if not pod["metadata"].get("deletionTimestamp")
        }

    def machines(self) -> dict[str, str]:
        """Return each workload's Kubernetes node."""
        return {name: pod["spec"]["nodeName"] for name, pod in self.pods().items()}

    def net1(self) -> dict[str, str]:
        """Return each workload's address on net1, as Multus tells it; without it: none."""
        found = {}
        for name, pod in self.pods().items():
            told = json.loads(pod["metadata"].get("annotations", {}).get(STATUS, "[]"))
            address = [one["ips"][0] for one in told if one["interface"] == "net1"]
            found.update({name: address[0]} if address else {})
        return found

    def heard(self, *, since: int | None = None) -> list[tuple[str, int]]:
        """Return what the listener has logged in these last seconds: talkers and numbers."""
        name = self.pods()["listener"]["metadata"]["name"]
        lines = self.cluster.logs(self.space, name, since_seconds=since)
        return [(match[1], int(match[2])) for match in map(HEARD.search, lines) if match]

    def talkers(self, *, since: int = 2) -> set[str]:
        """Return who was heard in these last seconds."""
        return {name for name, _ in self.heard(since=since)}

    def link(self, workload: str, interface: str, state: str) -> None:
        """Switch an interface of a pod, from a container that is put into it for that."""
        pod = self.pods()[workload]
        name = f"link-{uuid.uuid4().hex[:6]}"
        container = {
            "name": name,
            "image": pod["spec"]["containers"][0]["image"],
            "command": ["python3", "-c", LINK, interface, state],
            "securityContext": {"capabilities": {"add": ["NET_ADMIN"]}},
        }
        ref = ObjectRef("v1", "Pod", self.space, pod["metadata"]["name"])
        patch = {"spec": {"ephemeralContainers": [container]}}
        self.cluster.patch(ref, patch, style="strategic", subresource="ephemeralcontainers")
        wait_until(lambda: self._has_ended(ref, name), f"{interface} {state}")

    def _has_ended(self, ref: ObjectRef, container: str) -> bool:
        for one in self.cluster.get(ref)["status"].get("ephemeralContainerStatuses", ()):
            if one["name"] == container and (end := one["state"].get("terminated")):
                assert end["exitCode"] == 0, end
                return True
        return False


def apart(*, ros1: bool) -> dict[str, Any]:
    """Return a subnet and a DDS domain that hardly any other test has on this wire.

    Each process of the test run has some to itself; tests that name one name others.
    """
    process = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 8
    subnet = f"10.{232 + process}.{random.randint(0, 255)}.0/24"
    return {"subnet": subnet, **({} if ros1 else {"domain_id": 20 + 6 * process + next(DOMAINS)})}


@contextmanager
def projects(cluster: Any, context: str, registry: str, directory: Path) -> Iterator[Make]:
    """Give a function that makes projects of an example; their namespaces are deleted."""
    spaces: list[str] = []

    def make(example: str, base: str, change: Change = lambda _: None) -> Project:
        space = f"t-ros2-{uuid.uuid4().hex[:6]}"
        copied = directory / space
        subprocess.run(["cp", "-r", str(EXAMPLES / example), str(copied)], check=True)
        written = yaml.safe_load((copied / "Rigelfile").read_text())
        change(options := written["jobs"]["deploy"]["with"])
        network = options.get("network", {})
        if network.get("mode") == "macvlan":  # other tests share the wire
            ros1 = written["application"]["distro"] == "noetic"
            others = apart(ros1=ros1)
            if "gateway" in network:  # which is in its subnet
                others.pop("subnet")
            options["network"] = {**network, **others}
        (copied / "Rigelfile").write_text(yaml.safe_dump(written, sort_keys=False))
        cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": space}})
        spaces.append(space)
        env = {"REGISTRY": registry, "BASE_IMAGE": base}
        return Project(cluster, context, space, copied / "Rigelfile", env)

    yield make
    for space in spaces:
        cluster.delete(ObjectRef("v1", "Namespace", "", space))


@pytest.fixture(scope="module")
def project(cluster: Any, context: str, registry: str, tmp_path_factory: Any) -> Iterator[Make]:
    """Make projects: project(EXAMPLE, BASE_IMAGE, change), where change edits the deploy job."""
    with projects(cluster, context, registry, tmp_path_factory.mktemp("projects")) as make:
        yield make


@pytest.fixture(scope="module")
def own_cluster(tmp_path_factory: Any) -> Iterator[Make]:
    """Projects on a cluster of our own, whose machines may be lost."""
    from rigel_k8s.kube import connect
    from rigel_k8s.settings import Settings

    with machines.own_cluster("test-ros2", nodes=3, extras=["multus"]) as (name, registry):
        context = f"rigel-{name}"
        push_ros2(f"{registry}/ros:jazzy")
        rigel("--context", context, "network", "install")
        directory = tmp_path_factory.mktemp("own")
        with (
            connect(Settings(context=context)) as cluster,
            projects(cluster, context, registry, directory) as make,
        ):
            yield lambda example, **more: make(example, f"{registry}/ros:jazzy", **more)


@pytest.fixture(scope="session")
def work_image(registry: str, ros2_image: str) -> str:
    """The base image with the programs of ros2_work."""
    name = f"{registry}/ros2-work:jazzy"
    shared.once("ros2-work", lambda: image.push_work(name, ros2_image))
    return name

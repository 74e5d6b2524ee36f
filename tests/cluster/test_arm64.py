"""A robot's ARM computer beside an amd64 machine: one image for both, and a refusal without one.

The programs run under QEMU; tests/support/arm64.py describes such a machine.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import attrs
import pytest
import yaml

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube import connect
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.names import EXPORTER, EXPORTER_PORT
from rigel_k8s.settings import Settings
from rigel_lab.cluster import components
from tests.support import arm64, layer
from tests.support.until import until

from .conftest import inside, run_rigel
from .machines import own_cluster

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.slow,
    pytest.mark.skipif(not arm64.possible(), reason="needs qemu-user-static and arch-test"),
]
NAMESPACE = "arm"
AMD64, ARM64 = "node1", "node2"
PATIENCE = 900
#: A program of the image for each platform; `RUN` is emulated where it must be.
DOCKERFILE = """ARG BASE_IMAGE
ARG TARGETARCH
FROM ${BASE_IMAGE}-${TARGETARCH}
RUN uname -m >/built-on
"""
#: Its programs for arm64 are beside it.
DOCKERFILE_OF_NODE = """ARG BASE_IMAGE
FROM ${BASE_IMAGE}-arm64
COPY . /robot/
"""
#: A ROS 2 node on a middleware in memory, since there is no package of ROS 2 for arm64. The probe
#: looks for the ports of a participant of domain 5.
NODE = """
python3 -c '
import select, socket
sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
for port, one in enumerate(sockets, 8660):
    one.bind(("0.0.0.0", port))
while True:
    for one in select.select(sockets, [], [])[0]:
        one.recv(65536)
' &
(
  echo node n /
  echo create p /out 0
  while sleep 0.2; do echo publish /out 1; echo wait 100; done
) | /robot/main /robot/client.so
"""
TALKER = ["rostopic", "pub", "--rate", "2", "/chatter", "std_msgs/String", "data: hello"]
LISTENER = {
    "args": ["rostopic", "echo", "/chatter"],
    "placement": {"node": ARM64},
    "security_context": {"privileged": True},
}
#: QEMU has no seccomp, so an emulated containerd refuses each pod that is to have a profile of it,
#: and the kubelet wants one for all but privileged pods.
PRIVILEGED = {"securityContext": {"privileged": True}}
MASTER = {"name": "ros-master-container", **PRIVILEGED}


@attrs.frozen
class Mixed:
    """A cluster of both kinds of machines, and a directory with a Rigelfile for it."""

    cluster: Any
    name: str
    registry: str
    directory: Path
    kubectl: str

    @property
    def context(self) -> str:
        """The cluster's context."""
        return f"rigel-{self.name}"

    def rigel(self, *words: str, check: bool = True) -> Any:
        """Run `rigel` in the directory."""
        words = ("--context", self.context, *words)
        return run_rigel(*words, cwd=self.directory, check=check, timeout=PATIENCE)

    def write(self, image: str, **more: Any) -> None:
        """Write a Rigelfile whose talker is on one kind of machine, the rest on the other."""
        build = {
            "plugin": "rigel_k8s.BuildXPlugin",
            "with": {
                "image": image.removesuffix(":latest"),
                "push": True,
                "platforms": ["linux/amd64", "linux/arm64"],
                "buildargs": {"BASE_IMAGE": f"{self.registry}/ros:noetic"},
                "tool": "podman",
            },
        }
        options = {
            "namespace": NAMESPACE,
            "image": image,
            "timeout": PATIENCE,
            "deploy_ros_master": True,
            "ros_master_image": image,
            "ros_master_placement": {"node": ARM64},
            "nodes": {
                "talker": {"args": TALKER, "placement": {"node": AMD64}},
                "listener": LISTENER,
            },
            "additional_k8s_params": {
                "ros_master": {"spec": {"template": {"spec": {"containers": [MASTER]}}}}
            },
            **more,
        }
        jobs = {"build": build, "deploy": {"plugin": "rigel_k8s.OrchestrationPlugin"}}
        jobs["deploy"]["with"] = options
        text = yaml.safe_dump({"application": {"distro": "noetic"}, "jobs": jobs})
        (self.directory / "Rigelfile").write_text(text)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mixed]:
    """A cluster of an amd64 and an arm64 machine; base images of both are in its registry."""
    directory = tmp_path_factory.mktemp("mixed")
    (directory / "Dockerfile").write_text(DOCKERFILE)
    kubectl = components.obtain(print, ["kubectl"]).program("kubectl")
    with arm64.emulated(), own_cluster("test-arm64", nodes=2) as (name, registry):
        arm64.change(name, ARM64, kubectl)
        for arch in ("amd64", "arm64"):
            words = ("--arch", arch, "--push", f"{registry}/ros:noetic-{arch}")
            run_rigel("image", "ros1-base", *words, timeout=PATIENCE)
        with connect(Settings(context=f"rigel-{name}")) as cluster:
            yield Mixed(cluster, name, registry, directory, kubectl)


@pytest.fixture(scope="module")
def deployed(mixed: Mixed) -> Mixed:
    """The application on both, from an image that was built for both."""
    mixed.write(f"{mixed.registry}/robot:latest")
    mixed.rigel("run", "job", "build")
    mixed.rigel("run", "job", "deploy")
    return mixed


def test_a_machine_runs_the_image_of_its_own_processor(deployed: Mixed) -> None:
    """The same name and digest: amd64 on one, arm64 on the other; also while it was built."""
    found = {
        name: inside(deployed.cluster, NAMESPACE, name, "sh", "-c", "uname -m; cat /built-on")
        for name in ("talker", "listener", "ros-master")
    }
    arm, amd = "aarch64\naarch64\n", "x86_64\nx86_64\n"
    assert found == {"talker": amd, "listener": arm, "ros-master": arm}


def test_nodes_of_both_talk(deployed: Mixed) -> None:
    """Through the gate and the scripts in the pods, which run on arm64 like the master."""
    status = json.loads(deployed.rigel("status", "-o", "json").stdout)
    assert status["ready"], status
    heard = lambda: deployed.rigel("logs", "listener", "--tail", "5").stdout  # noqa: E731
    until(lambda: "hello" in heard(), "a message from amd64 to arm64", PATIENCE, last_words=heard)
    assert "/chatter" in deployed.rigel("graph").stdout


def test_a_gate_on_arm64_hands_a_name_over(deployed: Mixed) -> None:
    """The new talker on amd64 takes the old one's name; the listener on arm64 hears it."""
    again = [*TALKER[:-1], "data: hello again"]
    nodes = {"talker": {"args": again, "placement": {"node": AMD64}}, "listener": LISTENER}
    deployed.write(f"{deployed.registry}/robot:latest", nodes=nodes)
    deployed.rigel("run", "job", "deploy")
    talker = deployed.cluster.get(ObjectRef("apps/v1", "Deployment", NAMESPACE, "talker"))
    assert talker["spec"]["strategy"]["type"] == "RollingUpdate"
    heard = lambda: deployed.rigel("logs", "listener", "--tail", "5").stdout  # noqa: E731
    until(lambda: "hello again" in heard(), "a message of the new one", PATIENCE, last_words=heard)


def test_the_exporter_measures_on_arm64(deployed: Mixed) -> None:
    """Its own image for arm64 looks at the same graph; the rest of the stack is not needed."""
    image = f"{deployed.registry}/ros-exporter:arm64"
    run_rigel("image", "ros-exporter", "--arch", "arm64", "--push", image, timeout=PATIENCE)
    watched = {"enabled": True, "ros_metrics": {"image": image, "interval": "2s"}}
    deployed.write(f"{deployed.registry}/robot:latest", observability=watched)
    rendered = yaml.safe_load_all(deployed.rigel("render").stdout)
    for one in rendered:
        if EXPORTER in one["metadata"]["name"]:
            if one["kind"] == "Deployment":
                spec = one["spec"]["template"]["spec"]
                spec["nodeSelector"] = {"kubernetes.io/hostname": ARM64}
                spec.pop("securityContext", None)
                spec["containers"][0] |= PRIVILEGED
            deployed.cluster.apply(one)

    def read() -> str:
        own = {"app.kubernetes.io/name": EXPORTER}
        (pod,) = deployed.cluster.list("v1", "Pod", NAMESPACE, labels=own)
        name = f"{pod['metadata']['name']}:{EXPORTER_PORT}"
        ref = ObjectRef("v1", "Pod", NAMESPACE, name)
        return str(deployed.cluster.get_through_proxy(ref, "metrics").decode())

    talker = re.compile(r'^ros_node_up\{ros_node="/talker.*\} 1', re.M)
    what = "the exporter's metrics"
    until(lambda: talker.search(read()), what, PATIENCE, despite=(RigelK8sError, ValueError))


def test_a_ros2_node_on_arm64_hands_over(mixed: Mixed) -> None:
    """The library for arm64 is loaded, its keeper runs, and the new pod takes over."""
    folder = mixed.directory / "node"
    folder.mkdir()
    (folder / "Dockerfile").write_text(DOCKERFILE_OF_NODE)
    layer.build(folder, target="aarch64-linux-gnu.2.17")
    arm = attrs.evolve(mixed, directory=folder)
    namespace = {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "arm2"}}
    mixed.cluster.create(namespace)

    def write(version: str) -> None:
        image = f"{mixed.registry}/node"
        build = {"image": image, "push": True, "platforms": ["linux/arm64"], "tool": "podman"}
        build["buildargs"] = {"BASE_IMAGE": f"{mixed.registry}/ros:noetic"}
        args, env = ["/bin/sh", "-c", NODE], {"VERSION": version}
        node = {"args": args, "env": env, "placement": {"node": ARM64}}
        deploy = {"namespace": "arm2", "image": image, "nodes": {"n": node}}
        deploy["network"] = {"mode": "peers", "domain_id": 5}
        jobs = {
            "build": {"plugin": "rigel_k8s.BuildXPlugin", "with": build},
            "deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": deploy},
        }
        text = yaml.safe_dump({"application": {"distro": "jazzy"}, "jobs": jobs})
        (folder / "Rigelfile").write_text(text)

    def deploy(version: str) -> None:
        write(version)
        for one in yaml.safe_load_all(arm.rigel("render", "deploy").stdout):
            if one["kind"] == "Deployment":  # privileged by an option, it would be stopped first
                one["spec"]["template"]["spec"]["containers"][0] |= PRIVILEGED
            mixed.cluster.apply(one)

    def says(word: str) -> str:
        """Return what a pod whose keeper says a word runs, as its machine and its maps."""
        line = ["sh", "-c", f"grep -q '{word}' $RIGEL_RMW/progress && uname -m && cat /proc/*/maps"]
        for pod in mixed.cluster.list("v1", "Pod", "arm2"):
            with suppress(RigelK8sError):  # it has not started yet
                done = mixed.cluster.run("arm2", pod["metadata"]["name"], line)
                if done.stdout:
                    return str(done.stdout.decode())
        return ""

    write("v1")
    arm.rigel("run", "job", "build")
    deploy("v1")
    until(lambda: says("^works"), "the first pod works", PATIENCE)
    deploy("v2")
    found = until(lambda: says("took over from"), "the second pod takes over", PATIENCE)
    assert found.startswith("aarch64\n")
    assert "rmw-aarch64.so" in found


def test_an_image_without_the_machines_platform_is_refused(mixed: Mixed) -> None:
    """Before anything is changed, and with what the image runs on and what the machines are."""
    mixed.write(f"{mixed.registry}/ros:noetic-amd64", namespace="wrong")
    arm64.label(mixed.name, ARM64, mixed.kubectl)
    done = mixed.rigel("run", "job", "deploy", check=False)
    assert done.returncode != 0
    assert "runs on amd64, but the machines that may run it are arm64" in done.stderr
    assert not mixed.cluster.get(ObjectRef("v1", "Namespace", "", "wrong"))

"""A real cluster for the tests: RIGEL_TEST_CONTEXT, or the local one that all processes share."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Settings

from ..support import shared
from ..support.ros2base import push_ros2
from ..support.until import until
from .rights import DEPLOYER, INSTALLER, grant_role, write_impersonation

Rigel = Callable[..., subprocess.CompletedProcess[str]]


class Manifests(yaml.CSafeLoader):
    """Manifests that Go wrote, for which a plain `=` is a text."""


Manifests.add_constructor("tag:yaml.org,2002:value", Manifests.construct_yaml_str)  # type: ignore[type-var]


def run_rigel(
    *words: str, check: bool = True, cwd: Path | None = None, timeout: float = 600
) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own, as a user does; a failure shows its output."""
    done = subprocess.run(
        [sys.executable, "-m", "rigel_k8s", *words],
        check=False,
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    if check and done.returncode != 0:
        raise AssertionError(
            f"rigel {' '.join(words)} exited {done.returncode}\n{done.stdout}\n{done.stderr}"
        )
    return done


def first_container(pod: Any) -> str:
    """Return the name of a pod's container that comes first: its ROS program's."""
    return str(pod["spec"]["containers"][0]["name"])


def inside(cluster: Any, namespace: str, workload: str, *command: str) -> str:
    """Return what a command prints in a workload's pod, with ROS set up."""
    own = {"app.kubernetes.io/name": workload}
    found = cluster.list("v1", "Pod", namespace, labels=own)
    (pod,) = (pod for pod in found if not pod["metadata"].get("deletionTimestamp"))
    words = ["/bin/sh", "/rigel-k8s/exec.sh", *command]
    name, container = pod["metadata"]["name"], first_container(pod)
    done = cluster.run(namespace, name, words, container=container, timeout=180)
    assert done.code == 0, done
    return str(done.stdout.decode())


def pod_uids(cluster: Any, namespace: str) -> dict[str, str]:
    """Return the UID of each workload's only pod that is not being deleted."""
    found: dict[str, str] = {}
    for pod in cluster.list("v1", "Pod", namespace):
        name = pod["metadata"]["labels"]["app.kubernetes.io/name"]
        if "deletionTimestamp" not in pod["metadata"]:
            assert name not in found, f"two pods of {name}"
            found[name] = pod["metadata"]["uid"]
    return found


def write_idle(
    directory: Path, namespace: str, registry: str, nodes: Mapping[str, Mapping[str, Any]]
) -> None:
    """Write a Rigelfile with nodes that wait, without ROS, each with these further options."""
    wait = ["sh", "-c", "trap 'exit 0' INT TERM; while :; do sleep 0.1; done"]
    idle = {name: {"command": wait, "ros": "none", **more} for name, more in nodes.items()}
    options = {"image": f"{registry}/rigel-k8s/busybox:1", "namespace": namespace, "nodes": idle}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": {**options, "network": "peers"}}
    whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
    (directory / "Rigelfile").write_text(yaml.safe_dump(whole))


def wait_for_account(cluster: Any, namespace: str) -> None:
    """Wait until a new namespace has the account that pods run as: before, pods are refused."""
    account = ObjectRef("v1", "ServiceAccount", namespace, "default")
    until(lambda: cluster.get(account), f"account of the pods of {namespace}", 120)


@pytest.fixture(scope="session")
def context() -> str:
    """The name of a context that leads to a real cluster of at least three nodes."""
    if given := os.environ.get("RIGEL_TEST_CONTEXT"):
        return given
    if not shared.possible():
        pytest.skip("the local cluster needs root; name a cluster with RIGEL_TEST_CONTEXT instead")
    shared.start_cluster()
    return f"rigel-{shared.NAME}"


@pytest.fixture(scope="session")
def admin(context: str) -> Iterator[Any]:
    """A connection to the cluster of `context`, as its administrator."""
    from rigel_k8s.kube import connect

    with connect(Settings(context=context)) as connected:
        yield connected


@pytest.fixture(scope="session")
def cluster(admin: Any) -> Any:
    """The same; where a folder's tests work with fewer rights, they have them here."""
    return admin


@pytest.fixture(scope="session")
def deployer_config(context: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A kubeconfig of a user who has the Role that `rigel rbac deployer` prints, and nothing else.

    It is the administrator who asks in that user's name.
    """
    return write_impersonation(context, DEPLOYER, tmp_path_factory.mktemp("deployer"))


@pytest.fixture(scope="session")
def deployer(context: str, deployer_config: Path) -> Iterator[Any]:
    """The cluster as that user sees it."""
    from rigel_k8s.kube import connect

    with connect(Settings(context=context, kubeconfig=deployer_config)) as connected:
        yield connected


@contextmanager
def own_namespace(cluster: Any, prefix: str) -> Iterator[str]:
    """Make a namespace for the tests of one file, and delete it with all that is in it."""
    name = f"{prefix}-{uuid.uuid4().hex[:6]}"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    try:
        yield name
    finally:
        cluster.delete(ObjectRef("v1", "Namespace", "", name))


@pytest.fixture
def namespace(admin: Any, request: pytest.FixtureRequest) -> Iterator[str]:
    """A namespace for one test, deleted after it; the user of `deployer` may deploy into it."""
    name = f"t-{uuid.uuid4().hex[:8]}"
    admin.create(
        {
            "apiVersion": "v1",
            "kind": "Namespace",
            "metadata": {"name": name, "annotations": {"test": request.node.name}},
        }
    )
    grant_role(admin, name, "deployer", DEPLOYER)
    wait_for_account(admin, name)
    yield name
    admin.delete(ObjectRef("v1", "Namespace", "", name))


@pytest.fixture(scope="session")
def rigel(context: str) -> Rigel:
    """Run `rigel` against the test cluster: rigel("status", "-o", "json", cwd=tmp_path)."""

    def call(*words: str, **options: Any) -> subprocess.CompletedProcess[str]:
        return run_rigel("--context", context, *words, **options)

    return call


@pytest.fixture(scope="session")
def rigel_as_deployer(context: str, deployer_config: Path) -> Rigel:
    """Run `rigel` as that user."""

    def call(*words: str, **options: Any) -> subprocess.CompletedProcess[str]:
        place = ("--kubeconfig", str(deployer_config), "--context", context)
        return run_rigel(*place, *words, **options)

    return call


@pytest.fixture(scope="session")
def registry(admin: Any) -> str:
    """HOST:PORT of a registry that we can push to and the nodes pull from."""
    if given := os.environ.get("RIGEL_TEST_REGISTRY"):
        return given
    note = admin.get(ObjectRef("v1", "ConfigMap", "kube-public", "local-registry-hosting"))
    if not note:
        pytest.skip("this cluster tells no registry: name one with RIGEL_TEST_REGISTRY")
    return str(json.loads(note["data"]["localRegistryHosting.v1"])["host"])


@pytest.fixture(scope="session")
def installer(admin: Any, context: str, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The options with which `rigel` has the ClusterRole for installers, and nothing else."""
    grant_role(admin, "", "installer", INSTALLER)
    file = write_impersonation(context, INSTALLER, tmp_path_factory.mktemp("installer"))
    return ["--kubeconfig", str(file), "--context", context]


@pytest.fixture(scope="session")
def multus(installer: list[str]) -> None:
    """Multus and whereabouts on the cluster, as an installer installs them; they stay there."""

    def install() -> None:
        run_rigel(*installer, "network", "install")
        assert "attaches pods" in run_rigel(*installer, "network", "install").stdout
        assert "ready" in run_rigel(*installer, "network", "status").stdout

    shared.once("multus", install)


@pytest.fixture(scope="session")
def prometheus_operator(cluster: Any) -> None:
    """The Prometheus operator by upstream's own manifests, unchanged; it stays on the cluster."""
    from rigel_lab.cluster.components import BUILDS

    BUILDS["prometheus-operator"].build(print)
    manifests = (BUILDS["prometheus-operator"].directory / "prometheus-operator.yaml").read_text()
    for manifest in filter(None, yaml.load_all(manifests, Manifests)):
        cluster.apply(manifest)
    ref = ObjectRef("apps/v1", "Deployment", "default", "prometheus-operator")
    for event in cluster.watch("apps/v1", "Deployment", ref.namespace, seconds=300):
        if event.object["metadata"]["name"] == ref.name and event.object["status"].get(
            "readyReplicas"
        ):
            return
    raise AssertionError(f"{ref} is not ready: {cluster.get(ref)['status']}")


@pytest.fixture(scope="session")
def base_image(registry: str) -> str:
    """The ROS 1 base image in the cluster's registry."""
    name = f"{registry}/ros:noetic"
    words = ("image", "ros1-base", "--push", name)
    shared.once("ros1-base", lambda: run_rigel(*words, timeout=shared.BUILDS))
    return name


@pytest.fixture(scope="session")
def ros2_image(registry: str) -> str:
    """The ROS 2 base image in the cluster's registry."""
    name = f"{registry}/ros:jazzy"
    shared.once("ros2-base", lambda: push_ros2(name))
    return name


@pytest.fixture(scope="session")
def exporter_image(registry: str) -> str:
    """The exporter of this checkout in the cluster's registry, under a name of this run."""
    name = f"{registry}/test/ros-exporter:{shared.directory().name}"
    shared.once("exporter", lambda: run_rigel("image", "ros-exporter", "--push", name))
    return name

"""Pods with second networks on a real cluster, and clusters that a test may break."""

from __future__ import annotations

import json
import os
import signal
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.kube import connect
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Settings
from rigel_lab.cluster.api import mark_lost
from rigel_lab.cluster.state import find
from tests.support import until as waiting
from tests.support.recorder import Recorder

from ...support import shared
from ..conftest import wait_for_account

#: Always there once Multus is: any image with a shell would do.
IMAGE = "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick"
SLEEP = ["/bin/sh", "-c", "trap exit TERM; sleep 3600 & wait"]
LAN = "lan"


def until(look: Callable[[], Any], what: str, seconds: float = 120) -> Any:
    """Return what is looked for once it is there, or say what did not come."""
    return waiting.until(look, what, seconds, every=0.3)


@attrs.frozen
class Lab:
    """A namespace with an attachment `lan` to the nodes' own segment."""

    cluster: Any
    namespace: str

    def attachment(self, subnet: str) -> None:
        """Make the attachment: macvlan on eth0, addresses from whereabouts."""
        config = {
            "cniVersion": "0.3.1",
            "name": LAN,
            "type": "macvlan",
            "master": "eth0",
            "mode": "bridge",
            "ipam": {"type": "whereabouts", "range": subnet},
        }
        self.cluster.create(
            {
                "apiVersion": "k8s.cni.cncf.io/v1",
                "kind": "NetworkAttachmentDefinition",
                "metadata": {"name": LAN, "namespace": self.namespace},
                "spec": {"config": json.dumps(config)},
            }
        )

    def pod(self, name: str, *, node: str | None = None, attached: bool = True) -> dict[str, Any]:
        """Return a pod that sleeps, with or without the attachment."""
        annotations = {"k8s.v1.cni.cncf.io/networks": LAN} if attached else {}
        meta = {"name": name, "namespace": self.namespace, "annotations": annotations}
        container = {"name": "c", "image": IMAGE, "command": SLEEP}
        spec: dict[str, Any] = {"containers": [container], "terminationGracePeriodSeconds": 0}
        spec |= {"nodeName": node} if node else {}
        spec["tolerations"] = [{"operator": "Exists"}]
        return {"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": spec}

    def start(self, name: str, **how: Any) -> dict[str, Any]:
        """Start a pod and wait until it runs."""
        self.cluster.create(self.pod(name, **how))
        return self.running(name)

    def running(self, name: str) -> dict[str, Any]:
        """Return a pod once it runs."""
        ref = ObjectRef("v1", "Pod", self.namespace, name)

        def look() -> Any:
            live = self.cluster.get(ref)
            return live if live and live["status"].get("phase") == "Running" else None

        return dict(until(look, f"running pod {name}"))

    def end(self, name: str) -> None:
        """End a pod and wait until it is gone."""
        ref = ObjectRef("v1", "Pod", self.namespace, name)
        self.cluster.delete(ref, grace_seconds=0)
        until(lambda: self.cluster.get(ref) is None, f"end of {name}")

    def inside(self, name: str, *words: str) -> str:
        """Return what a program says inside a pod."""
        done = self.cluster.run(self.namespace, name, list(words))
        return (done.stdout + done.stderr).decode()

    @property
    def nodes(self) -> list[str]:
        """The names of the cluster's nodes."""
        return sorted(node["metadata"]["name"] for node in self.cluster.nodes())

    def pods(self) -> list[dict[str, Any]]:
        """Return all pods of the namespace."""
        return list(self.cluster.list("v1", "Pod", self.namespace))

    @staticmethod
    def until(look: Callable[[], Any], what: str, seconds: float = 120) -> Any:
        """Return what is looked for once it is there, or say what did not come."""
        return until(look, what, seconds)

    @staticmethod
    def address_of(pod: dict[str, Any]) -> str:
        """Return a pod's address on its second network, "" for none."""
        notes = pod["metadata"].get("annotations", {})
        entries = json.loads(notes.get("k8s.v1.cni.cncf.io/network-status", "[]"))
        return next((str(e["ips"][0]) for e in entries if e.get("interface") == "net1"), "")

    def has_interface(self, name: str) -> bool:
        """Return whether the interface is really there, whatever an annotation says."""
        return "net1" in self.inside(name, "ls", "/sys/class/net").split()


@attrs.frozen
class Own:
    """A local cluster that belongs to the tests that break one.

    Attributes:
        directory: where the machine keeps the nodes' files.
        data_dir: k3s' data directory inside a node, None on plain nodes.
    """

    cluster: Any
    context: str
    directory: Path
    data_dir: str | None

    @property
    def name(self) -> str:
        """The cluster's name."""
        return self.context.removeprefix("rigel-")

    def stop(self, node: str) -> None:
        """Switch a node off, and tell the cluster, which would find out in 50 s."""
        os.kill(int((self.directory / node / "process").read_text().split()[0]), 9)
        mark_lost(find(self.name).layout, node)
        until(lambda: not self.is_up(node), f"loss of {node}")

    def signal_keepers(self, node: str, number: signal.Signals) -> None:
        """Send a signal to what keeps a node's files; a node's processes are this machine's too."""
        found, marks = [], {b"PART=multus", f"NODE={node}".encode()}
        for place in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                words = (place / "cmdline").read_bytes().split(b"\0")
                said = (place / "environ").read_bytes().split(b"\0")
                home = (place / "cgroup").read_text()
                keeps = words[2:3] == [b"keep"] and marks <= set(said)
                if keeps and f"/{self.context}/" in home:
                    found.append(int(place.name))
        assert found
        for pid in found:
            os.kill(pid, number)

    def is_up(self, node: str) -> bool:
        """Return whether a node is Ready."""
        live = self.cluster.get(ObjectRef("v1", "Node", "", node))
        conditions = {c["type"]: c["status"] for c in live["status"]["conditions"]}
        return conditions.get("Ready") == "True"

    def start(self, node: str) -> None:
        """Switch a node on again."""
        from rigel_lab import cluster as lab

        lab.up(self.name, report=print)
        until(lambda: self.is_up(node), f"return of {node}")

    def conf(self, node: str) -> Path:
        """Return where a node's CNI configuration is, seen from here."""
        base = self.directory / node
        return base / "k3s/agent/etc/cni/net.d" if self.data_dir else base / "etc-cni/net.d"

    def programs(self, node: str) -> Path:
        """Return where a node's CNI programs are, seen from here."""
        base = self.directory / node
        return base / "k3s/data/cni" if self.data_dir else base / "opt-cni/bin"


#: Multus on plain nodes is what the shared cluster has; here k3s' layout is the harder one.
LAYOUTS = [pytest.param(None, id="plain", marks=pytest.mark.slow), pytest.param("/data", id="k3s")]


@pytest.fixture(scope="session", params=LAYOUTS)
def started(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Settings, Path, str | None]]:
    """How to reach a cluster of two nodes that may be broken, its directory, and k3s'."""
    if os.geteuid() != 0:
        pytest.skip("a cluster of one's own needs root")
    from rigel_lab import cluster as lab

    name, data_dir = shared.mine("test-own"), request.param
    lab.down(name)  # that of a run that was killed
    kubeconfig = tmp_path_factory.mktemp("kube") / "config"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("KUBECONFIG", str(kubeconfig))
        status = lab.up(name, 2, extras=["multus"], data_dir=data_dir, report=print)
    yield Settings(context=f"rigel-{name}", kubeconfig=kubeconfig), Path(status.logs), data_dir
    lab.down(name, report=print)


@pytest.fixture(scope="module")
def own(started: tuple[Settings, Path, str | None]) -> Iterator[Own]:
    """The cluster that may be broken; the next module has it as this one leaves it."""
    settings, directory, data_dir = started
    with pytest.MonkeyPatch.context() as patch, connect(settings) as cluster:
        patch.setenv("KUBECONFIG", str(settings.kubeconfig))
        yield Own(cluster, str(settings.context), directory, data_dir)


@pytest.fixture
def lab(cluster: Any, namespace: str) -> Lab:
    """A namespace of the shared cluster."""
    return Lab(cluster, namespace)


@pytest.fixture
def own_lab(own: Own) -> Iterator[Lab]:
    """A namespace of a cluster of one's own."""
    name = f"t-{uuid.uuid4().hex[:8]}"
    own.cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    wait_for_account(own.cluster, name)
    yield Lab(own.cluster, name)
    own.cluster.delete(ObjectRef("v1", "Namespace", "", name))


@pytest.fixture
def said() -> Recorder:
    """A reporter that keeps what it was told."""
    return Recorder()

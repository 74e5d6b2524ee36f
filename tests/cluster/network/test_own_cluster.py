"""Multus on clusters that may be broken: installed, upgraded under, restarted, removed.

The tests of this module go on one after the other on the same cluster, in this order.
"""

from __future__ import annotations

import itertools
import re
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import UserError
from rigel_k8s.network.options import Install
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import DeployOptions
from rigel_lab.cluster import components, k3s
from rigel_multus.install import install
from rigel_multus.installation import RELEASE, WHEREABOUTS_IMAGE
from rigel_multus.interfaces import find_without_interface
from rigel_multus.removal import remove, users
from rigel_multus.status import network_status

pytestmark = pytest.mark.cluster

#: The same image by another name, which the local cluster's registry serves as well.
MULTUS = "k8snetworkplumbingwg/multus-cni:v4.3.0-thick"
CRD = "apiextensions.k8s.io/v1", "CustomResourceDefinition"


@pytest.fixture(scope="module")
def before(own: Any) -> dict[str, list[str]]:
    """The files of CNI on every node before anything was installed."""
    return {node: files(own, node) for node in ("node1", "node2")}


def files(own: Any, node: str) -> list[str]:
    """Return all that CNI has on a node."""
    places = [own.conf(node), own.programs(node), own.directory / node / "etc-cni"]
    return sorted({str(p) for place in places for p in place.rglob("*") if not p.is_dir()})


def daemon(own: Any, node: str) -> dict[str, Any]:
    """Return the pod of Multus on a node."""
    labels = {"app.kubernetes.io/name": "rigel-multus"}
    pods = own.cluster.list("v1", "Pod", RELEASE.namespace, labels=labels)
    living = [p for p in pods if not p["metadata"].get("deletionTimestamp")]
    return next(p for p in living if p["spec"]["nodeName"] == node)


def has_new_daemon(own: Any, node: str, old: str) -> bool:
    """Return whether Multus has another ready pod on a node than this one."""
    with suppress(StopIteration):  # there is none for a moment
        new = daemon(own, node)
        return new["metadata"]["uid"] != old and is_ready(new)
    return False


def test_install(own: Any, own_lab: Any, said: Any, before: dict[str, list[str]]) -> None:
    """It is recognised where CNI's files are, and a pod on every node gets macvlan."""
    done = install(own.cluster, Install(), DeployOptions(report=said))
    assert done.nodes == ("node1", "node2")
    status = network_status(own.cluster, Install())
    assert status.ok
    kind = "k3s" if own.data_dir else "plain"
    assert {(n.platform, n.proven) for n in status.nodes} == {(kind, True)}
    own_lab.attachment("10.213.9.0/24")
    for node in own_lab.nodes:
        own_lab.start(f"on-{node}", node=node)
        assert own_lab.has_interface(f"on-{node}")
    new = set(files(own, "node1")) - set(before["node1"])
    assert str(own.conf("node1") / "00-multus.conf") in new
    assert str(own.programs("node1") / "multus-shim") in new


def test_the_clusters_own_addresses_come_back(own: Any, own_lab: Any) -> None:
    """A pod that ends gives its first network's address back too (multus#1449)."""
    given = own.directory / "node1/cni/networks/rigel"

    def addresses() -> set[str]:
        return {path.name for path in given.iterdir() if path.name[0].isdigit()}

    held = addresses()
    for number in range(3):
        own_lab.start(f"brief-{number}", node="node1", attached=False)
        own_lab.end(f"brief-{number}")
    own_lab.until(lambda: addresses() <= held, "the addresses of pods that ended")


def test_pods_of_a_restart_get_their_network(own: Any, own_lab: Any) -> None:
    """While the daemon is away pods wait for it, and none comes up without its network."""
    own_lab.attachment("10.213.10.0/24")
    conf, gone = own.conf("node1") / "00-multus.conf", threading.Event()
    over = threading.Event()

    def watch() -> None:
        while not over.wait(0.01):
            if not conf.exists():
                gone.set()

    watcher = threading.Thread(target=watch)
    watcher.start()
    old = daemon(own, "node1")["metadata"]
    own.cluster.delete(ObjectRef("v1", "Pod", RELEASE.namespace, old["name"]))
    names = [f"meanwhile-{number}" for number in range(6)]
    for name in names:
        own.cluster.create(own_lab.pod(name, node="node1"))
        time.sleep(0.5)
    pods = [own_lab.running(name) for name in names]
    over.set()
    watcher.join()
    own_lab.until(lambda: has_new_daemon(own, "node1", old["uid"]), "new pod of Multus")
    assert find_without_interface(pods) == []
    assert all(own_lab.has_interface(name) for name in names)
    assert not gone.is_set()


@pytest.fixture
def without_configuration(own: Any, own_lab: Any) -> Iterator[None]:
    """Node1's Multus configuration is away, and what would bring it back stands still."""
    own.signal_keepers("node1", signal.SIGSTOP)
    conf = own.conf("node1") / "00-multus.conf"
    conf.rename(conf.with_suffix(".away"))
    yield
    conf.with_suffix(".away").unlink()
    own.signal_keepers("node1", signal.SIGCONT)
    own_lab.until(conf.exists, "configuration")


def test_a_pod_without_its_network_is_noticed(
    own: Any, own_lab: Any, without_configuration: None
) -> None:
    """A pod that did come up without it, as others' Multus lets them, is named."""
    own_lab.attachment("10.213.11.0/24")
    numbers = itertools.count()

    def start() -> str | None:
        """The name of a pod that is deaf: the runtime reads its directory anew in a moment."""
        name = f"deaf-{next(numbers)}"
        own_lab.start(name, node="node1")
        return None if own_lab.has_interface(name) else name

    deaf = own_lab.until(start, "pod without its network")
    status = network_status(own.cluster, Install())
    assert not status.ok
    assert [str(missing) for missing in status.missing] == [
        f"pod {own_lab.namespace}/{deaf} on node1 runs without its network {own_lab.namespace}/lan"
    ]


def test_what_an_upgrade_takes_away_comes_back(own: Any, own_lab: Any) -> None:
    """After an upgrade of the machine pods are attached: with k3s' hashed directory replaced."""
    own_lab.attachment("10.213.12.0/24")
    if own.data_dir:
        upgrade(own, f"v{components.KUBERNETES_VERSION}+k3s2")
        upgrade(own, f"v{components.KUBERNETES_VERSION}+k3s3")
    else:
        for name in ("multus-shim", "whereabouts"):
            (own.programs("node1") / name).unlink()
        for name in ("multus-shim", "whereabouts"):
            own_lab.until((own.programs("node1") / name).exists, name)
    own_lab.start("after", node="node1")
    assert own_lab.has_interface("after")


def upgrade(own: Any, release: str) -> None:
    """Let node1 have a newer k3s; like k3s, forget the release before the previous one."""
    base = own.directory / "node1/k3s"
    programs = components.obtain(print).cni_plugins
    before = {path for path in (base / "data").iterdir() if len(path.name) == 64}
    fresh = k3s.unpack(base, own.data_dir, programs, release)
    previous = Path((base / "data/previous").readlink()).name
    for old in before:
        if old.name not in (fresh, previous):
            shutil.rmtree(old)


def test_a_node_that_is_away_keeps_nobody_waiting(own: Any, own_lab: Any, said: Any) -> None:
    """A node that is off is named and left out, also of an update; it has it when it is back."""
    own.stop("node2")
    done = install(own.cluster, Install(), DeployOptions(report=said))
    assert (done.nodes, done.away) == (("node1",), ("node2",))
    assert said.warnings == ["machine node2 is not ready: the installation does not wait for it"]
    old = daemon(own, "node1")["metadata"]["uid"]
    changed = Install(whereabouts_image=WHEREABOUTS_IMAGE, multus_image=f"docker.io/{MULTUS}")
    done = install(own.cluster, changed, DeployOptions(report=said))
    assert (done.nodes, done.away) == (("node1",), ("node2",))
    new = daemon(own, "node1")
    assert new["metadata"]["uid"] != old
    assert new["spec"]["containers"][0]["image"] == f"docker.io/{MULTUS}"
    with pytest.raises(UserError) as error:
        remove(own.cluster, Install(), DeployOptions(report=said))
    assert "machine node2 is unreachable and keeps Multus' configuration" in error.value.details
    own.start("node2")
    done = install(own.cluster, Install(), DeployOptions(report=said))
    assert (done.nodes, done.away) == (("node1", "node2"), ())
    # What another Rigelfile has said of images stays.
    images = {c["image"] for c in daemon(own, "node2")["spec"]["containers"]}
    assert images == {f"docker.io/{MULTUS}"}


def test_removal_leaves_nodes_that_start_pods(
    own: Any, own_lab: Any, said: Any, before: dict[str, list[str]]
) -> None:
    """After it every node starts pods, has the files that it had before, and no more."""
    own_lab.until(lambda: not users(own.cluster), "end of the pods of other tests")
    done = remove(own.cluster, Install(), DeployOptions(report=said))
    assert done.away == ()
    for node in own_lab.nodes:
        own_lab.start(f"plain-{node}", node=node, attached=False)
        assert own_lab.inside(f"plain-{node}", "ls", "/sys/class/net").split() == ["eth0", "lo"]
    assert {node: new(own, node, before) for node in before} == {"node1": [], "node2": []}
    left = [
        f"{live['kind']} {live['metadata']['name']}"
        for kind in (
            ("apps/v1", "DaemonSet"),
            ("apps/v1", "Deployment"),
            ("v1", "ConfigMap"),
            ("v1", "Secret"),
            ("v1", "ServiceAccount"),
            ("rbac.authorization.k8s.io/v1", "ClusterRole"),
            ("rbac.authorization.k8s.io/v1", "ClusterRoleBinding"),
        )
        for live in own.cluster.list(*kind)
        if re.match("rigel[.-](multus|whereabouts|network)", live["metadata"]["name"])
    ]
    assert left == []
    assert own.cluster.get(ObjectRef(*CRD, "", "network-attachment-definitions.k8s.cni.cncf.io"))


def new(own: Any, node: str, before: dict[str, list[str]]) -> list[str]:
    """Return what CNI has more on a node than before, k3s' own releases left aside."""
    return [path for path in files(own, node) if path not in before[node]]


def test_it_can_be_installed_again(own: Any, own_lab: Any, said: Any) -> None:
    """What was removed can be installed again, by two at once, and removed with all its kinds."""
    both = own.cluster.parallel(
        lambda _: install(own.cluster, Install(), DeployOptions(report=said)), (1, 2)
    )
    assert [done.nodes for done in both] == [("node1", "node2")] * 2
    own_lab.attachment("10.213.15.0/24")
    own_lab.start("again", node="node2")
    assert own_lab.has_interface("again")
    own_lab.end("again")
    remove(own.cluster, Install(), DeployOptions(report=said), definitions=True)
    own_lab.until(
        lambda: not any("cni.cncf.io" in d["metadata"]["name"] for d in own.cluster.list(*CRD)),
        "end of the kinds, whose objects Kubernetes deletes first",
    )

"""Several networks a pod on the local cluster, by upstream's own manifests; and nodes like k3s'.

Multus and whereabouts are installed here without anything of rigel's: what is shown is that their
images, the CNI programs and the Ethernet segment are what upstream expects.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rigel_lab.cluster import components, k3s
from rigel_lab.cluster.commands import run
from rigel_lab.cluster.extras import list_offered
from rigel_lab.cluster.gobuild import GoBuild, toolchain
from rigel_lab.images import exporter
from tests.support.recorder import Recorder

from .conftest import WITHIN

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.slow,  # the shared cluster and that of tests/cluster/network use the same
    pytest.mark.skipif(os.geteuid() != 0, reason="the local cluster needs root"),
]

PLAIN, RANCH = "t-multus", "t-k3s"
NODES = ("node1", "node2", "node3")
DATA = "/opt/k3s"
CRDS = ("ippools", "nodeslicepools", "overlappingrangeipreservations")
ATTACHMENT = {
    "apiVersion": "k8s.cni.cncf.io/v1",
    "kind": "NetworkAttachmentDefinition",
    "metadata": {"name": "robots"},
    "spec": {
        "config": json.dumps(
            {
                "cniVersion": "0.3.1",
                "type": "macvlan",
                "master": "eth0",
                "mode": "bridge",
                "ipam": {"type": "whereabouts", "range": "192.168.77.0/24"},
            }
        )
    },
}
#: Says its own address to a multicast group on one interface, and prints whom it hears there;
#: a message whose sender is somebody else is told as such.
GROUP = """
import socket, sys, time
own, others = sys.argv[1], int(sys.argv[2])
group, port = "239.255.0.1", 7400
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(own))
s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
s.bind(("", port))
s.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP,
             socket.inet_aton(group) + socket.inet_aton(own))
s.settimeout(0.1)
heard, end = set(), time.monotonic() + (60 if others else 5)
while time.monotonic() < end:
    s.sendto(own.encode(), (group, port))
    try:
        said, sender = s.recvfrom(99)
        same = sender == (said.decode(), port)
        heard.add(said.decode() if same else f"{said.decode()} from {sender}")
    except TimeoutError:
        pass
    if others and len(heard) == others and end > time.monotonic() + 0.5:
        end = time.monotonic() + 0.5
print(*sorted(heard))
"""


def module_of(build: GoBuild) -> Path:
    """Return the directory of a Go module, with upstream's manifests."""
    go, environment = toolchain(print)
    words = [go, "mod", "download", "-json", f"{build.module}@v{build.version}"]
    return Path(json.loads(run(words, cwd=build.lock, env=environment))["Dir"])


@pytest.fixture(scope="module")
def plain(host: Any, before: dict[str, list[str]]) -> str:
    """A cluster of three nodes that offers nothing besides."""
    host.rigel("up", "--name", PLAIN, "--nodes", "3")
    return PLAIN


@pytest.fixture(scope="module")
def offering(host: Any, plain: str) -> str:
    """The same cluster when it offers Multus."""
    host.rigel("up", "--name", plain, "--with", "multus")
    return plain


@pytest.fixture(scope="module")
def attached(host: Any, offering: str) -> dict[str, dict[str, str]]:
    """Pods with a second network on each node: pod -> interface -> address."""
    install_multus(host, offering)
    host.kubectl(offering, "apply", "-f", "-", text=json.dumps(ATTACHMENT))
    image = f"{host.status(offering)['registry']}/rigel-k8s/busybox:1"
    networks = {"annotations": {"k8s.v1.cni.cncf.io/networks": "robots"}}
    for node in NODES:
        script = f"echo {node} >/tmp/name; exec busybox sleep 7{node[-1]}77"
        text = host.pod(f"p-{node}", image, script, nodeName=node, metadata=networks)
        host.kubectl(offering, "apply", "-f", "-", text=text)
    ready = ["wait", "pod", "--all", "--for=condition=Ready", WITHIN]
    assert host.kubectl(offering, *ready).count("condition met") == 3
    return {node: addresses(host, offering, f"p-{node}") for node in NODES}


def install_multus(host: Any, cluster: str) -> None:
    """Apply upstream's manifests, unchanged but for the tags."""
    multus, whereabouts = (module_of(components.BUILDS[name]) for name in ("multus", "whereabouts"))
    thick = (multus / "deployments/multus-daemonset-thick.yml").read_text()
    crds = whereabouts / "doc/crds"
    texts = [thick.replace(":snapshot-thick", ":v4.3.0-thick")]
    texts += [(crds / f"whereabouts.cni.cncf.io_{name}.yaml").read_text() for name in CRDS]
    texts += [(crds / "daemonset-install.yaml").read_text().replace(":latest", ":v0.9.4")]
    for text in texts:
        host.kubectl(cluster, "apply", "-f", "-", text=text)
    for name in ("kube-multus-ds", "whereabouts"):
        words = ["-n", "kube-system", "rollout", "status", f"daemonset/{name}"]
        host.kubectl(cluster, *words, WITHIN)


def addresses(host: Any, cluster: str, name: str) -> dict[str, str]:
    """Return a pod's addresses by interface, as Multus tells them."""
    pod = json.loads(host.kubectl(cluster, "get", "pod", name, "-o", "json"))
    told = json.loads(pod["metadata"]["annotations"]["k8s.v1.cni.cncf.io/network-status"])
    return {network["interface"]: network["ips"][0] for network in told}


def heard(host: Any, pods: dict[str, dict[str, str]], interface: str, others: int) -> list[str]:
    """Let all pods speak and listen on an interface at once; return what each heard."""
    found = {text: pid for pid, text in host.processes().items() if "busybox sleep 7" in text}
    places = {
        f"/proc/{found[f'busybox sleep 7{node[-1]}77']}/ns/net": pod[interface]
        for node, pod in pods.items()
    }
    return conversation(host, places, others)


def conversation(host: Any, places: dict[str, str], others: int) -> list[str]:
    """Let each network namespace speak from its address; return what each heard."""
    speakers = [
        subprocess.Popen(
            host.command("nsenter", f"--net={place}", sys.executable, "-c", GROUP)
            + [address, str(others)],
            stdout=subprocess.PIPE,
            text=True,
        )
        for place, address in places.items()
    ]
    return [speaker.communicate(timeout=180)[0].strip() for speaker in speakers]


def test_nothing_is_offered_unless_asked_for(host: Any, plain: str) -> None:
    """A cluster starts without what only some need."""
    assert host.status(plain)["offers"] == []


def test_a_running_cluster_gains_what_is_asked_for(host: Any, offering: str) -> None:
    """`up --with` adds the images; status tells their names, a second one changes nothing."""
    offers = host.status(offering)["offers"]
    assert "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick" in offers
    assert "ghcr.io/k8snetworkplumbingwg/whereabouts:v0.9.4" in offers
    assert "Adding" not in host.rigel("up", "--name", offering, "--with", "multus")
    assert host.status(offering)["offers"] == offers
    assert host.status(offering)["extras"] == ["multus"]


def test_a_running_cluster_gains_another_extra(host: Any, offering: str) -> None:
    """What it offered stays; an image that is no program of its own comes too, once."""
    components.obtain(print, ["observability"])  # the machine itself reaches nothing
    exporter.build(Recorder())
    before = host.status(offering)["offers"]
    words = ["up", "--name", offering, "--with", "observability"]
    assert f"Adding {exporter.UPSTREAM} to the registry" in host.rigel(*words)
    offers = host.status(offering)["offers"]
    assert set(before) | set(list_offered(["observability"])) <= set(offers)
    assert exporter.UPSTREAM in offers
    assert host.status(offering)["extras"] == ["multus", "observability"]
    assert "Adding" not in host.rigel(*words)


def test_nodes_hear_each_others_multicast(host: Any, plain: str) -> None:
    """On the segment itself, and from its sender's own address and port."""
    nodes = {node["name"]: node["address"] for node in host.status(plain)["nodes"]}
    places = {f"/run/netns/rigel-{plain}-{name}": address for name, address in nodes.items()}
    expected = [
        " ".join(other for other in nodes.values() if other != address)
        for address in nodes.values()
    ]
    assert conversation(host, places, 2) == expected


def test_the_nodes_have_the_standard_cni_programs(host: Any, offering: str) -> None:
    """Each node has all of them, so that any attachment works."""
    wanted = {"macvlan", "ipvlan", "host-local", "static", "dhcp", "tuning", "bridge"}
    for node in NODES:
        programs = host.directory / "state/clusters" / offering / node / "opt-cni/bin"
        assert wanted <= {path.name for path in programs.iterdir()}


def test_upstreams_manifests_give_pods_a_second_network(
    attached: dict[str, dict[str, str]],
) -> None:
    """Multus and whereabouts run as upstream installs them; no address is given twice."""
    found = {pod["net1"] for pod in attached.values()}
    assert len(found) == 3
    assert all(address.startswith("192.168.77.") for address in found)


def test_multicast_reaches_other_nodes_on_macvlan_alone(
    host: Any, attached: dict[str, dict[str, str]]
) -> None:
    """On net1 every pod hears those of the two other nodes; on the pod network nobody anybody."""
    everybody = sorted(pod["net1"] for pod in attached.values())
    expected = [
        " ".join(other for other in everybody if other != pod["net1"]) for pod in attached.values()
    ]
    assert heard(host, attached, "net1", 2) == expected
    assert heard(host, attached, "eth0", 0) == ["", "", ""]


def test_down_leaves_nothing_of_second_networks(
    host: Any, before: dict[str, list[str]], attached: dict[str, dict[str, str]]
) -> None:
    """Macvlan links, Multus' sockets and what it wrote on nodes go with the cluster."""
    host.rigel("down", "--name", PLAIN)
    assert host.changes(before) == {}


@pytest.fixture(scope="module")
def ranch(host: Any, before: dict[str, list[str]]) -> str:
    """A node as k3s lays it out, with a data directory of its own."""
    words = ["--nodes", "1", "--k3s", DATA]
    host.rigel("up", "--name", RANCH, *words)
    return RANCH


def own(host: Any) -> Path:
    """Return what the node has of its own."""
    return Path(host.directory, "state/clusters", RANCH, "node1")


def test_a_node_says_that_it_is_of_k3s(host: Any, ranch: str) -> None:
    """Version, label, arguments and variables, by which its data directory is found."""
    node = json.loads(host.kubectl(ranch, "get", "node", "node1", "-o", "json"))
    released = f"v{components.KUBERNETES_VERSION}"
    assert node["status"]["nodeInfo"]["kubeletVersion"] == f"{released}+k3s1"
    told = node["metadata"]["annotations"]
    assert json.loads(told["k3s.io/node-args"]) == ["server", "--data-dir", DATA]
    assert json.loads(told["k3s.io/node-env"])["K3S_DATA_DIR"].startswith(f"{DATA}/data/")
    assert node["metadata"]["labels"]["node.kubernetes.io/instance-type"] == "k3s"


def test_its_cni_is_in_the_data_directory_alone(host: Any, ranch: str) -> None:
    """There is neither /etc/cni/net.d nor /opt/cni/bin on such a node, and no macvlan."""
    assert list((own(host) / "etc-cni").iterdir()) == []
    assert list((own(host) / "opt-cni").iterdir()) == []
    assert (own(host) / "k3s/agent/etc/cni/net.d/10-rigel.conflist").exists()
    programs = own(host) / "k3s/data/cni"
    assert {path.name for path in programs.iterdir()} == {"cni", *k3s.PROGRAMS}
    assert all(str(path.readlink()).startswith(f"{DATA}/data/") for path in programs.iterdir())


def test_its_kubeconfig_works_from_elsewhere(host: Any, ranch: str) -> None:
    """With the server's address for 127.0.0.1 a laptop uses its k3s.yaml."""
    path = own(host) / "etc-rancher/k3s/k3s.yaml"
    assert path.stat().st_mode & 0o777 == 0o600
    address = host.status(ranch)["nodes"][0]["address"]
    laptop = host.directory / "laptop.yaml"
    laptop.write_text(path.read_text().replace("127.0.0.1", address))
    kubectl = components.obtain(print, ["kubectl"]).program("kubectl")
    nodes = host.run(kubectl, f"--kubeconfig={laptop}", "get", "nodes", "-o", "name")
    assert nodes == "node/node1\n"
    assert f"https://{address}:6443" in laptop.read_text()


def test_pods_start_after_an_upgrade(host: Any, ranch: str) -> None:
    """New links, the old release gone: pods start; a program of somebody else is still there."""
    theirs = own(host) / "k3s/data/cni/theirs"
    theirs.write_text("#!/bin/sh\n")
    old = (own(host) / "k3s/data/current").readlink()
    plugins = components.obtain(print).cni_plugins
    new = k3s.unpack(own(host) / "k3s", DATA, plugins, "an upgrade")
    shutil.rmtree(own(host) / "k3s/data" / old.name)
    assert new != old.name
    image = f"{host.status(ranch)['registry']}/rigel-k8s/busybox:1"
    text = host.pod("after", image, "echo runs", restartPolicy="Never")
    host.kubectl(ranch, "apply", "-f", "-", text=text)
    assert host.wait_for_success(ranch, "after") == "runs\n"
    assert theirs.exists()


def test_a_node_that_is_started_again_is_as_before(host: Any, ranch: str) -> None:
    """`up` without a word of k3s keeps its places, and refuses others."""
    lost = [pid for pid, text in host.processes().items() if "node1/init.sh" in text]
    host.run("sh", "-c", f"kill -9 {' '.join(lost)}", check=False)
    host.until(lambda: not host.status(ranch)["running"], "end of node1")
    host.rigel("up", "--name", ranch)
    assert host.status(ranch)["nodes"][0]["ready"]
    told = host.rigel("up", "--name", ranch, "--k3s", "/other", check=False)
    assert "was not made with --k3s /other" in told


def test_an_image_is_loaded(host: Any, ranch: str) -> None:
    """`load` finds containerd where k3s has it."""
    host.rigel("load", "--name", ranch, str(host.archive("docker.io/library/loaded:8")))
    host.kubectl(
        ranch,
        "apply",
        "-f",
        "-",
        text=host.pod("l", "loaded:8", "echo runs", restartPolicy="Never"),
    )
    assert host.wait_for_success(ranch, "l") == "runs\n"


def test_down_leaves_nothing_of_k3s(host: Any, before: dict[str, list[str]], ranch: str) -> None:
    """Its data directory, hashed directories and mount point go with the cluster."""
    host.rigel("down", "--name", ranch)
    assert host.changes(before) == {}

"""A machine: Multus is recognised whoever installed it, and the script runs on real machines."""

from __future__ import annotations

import shutil
import subprocess
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest

from rigel_multus.installation import runs
from rigel_multus.preflight.machine import PROBE, Daemon, Interface, parse, read_daemon

from .cases import MACHINES, machine

SHELLS = [["sh"], ["dash"], ["bash", "--posix"], ["busybox", "sh"]]


def run(*arguments: str, shell: list[str] | None = None) -> str:
    done = subprocess.run(
        [*(shell or ["sh"]), "-c", PROBE, "preflight", *arguments],
        check=True,
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.stderr == ""
    return done.stdout


def test_a_recorded_machine_is_read() -> None:
    """Interfaces, addresses and programs of a node of the local cluster, recorded there."""
    facts = machine()
    assert facts.interfaces["eth0"] == Interface("eth0", mtu=1400)
    assert facts.default_interface == "eth0"
    assert ip_address("10.66.0.12") in facts.addresses
    assert ip_address("127.0.0.1") not in facts.addresses
    assert {"macvlan", "static", "whereabouts"} <= facts.programs["/opt/cni/bin"]


def test_half_an_answer_is_none() -> None:
    """An answer that was cut short is refused, not taken for a machine without programs."""
    text = (MACHINES / "node2.txt").read_text("utf-8")
    with pytest.raises(ValueError, match="incomplete"):
        parse(text[: len(text) // 2])


@pytest.mark.programs
@pytest.mark.skipif(not Path("/proc/net/fib_trie").exists(), reason="needs Linux")
@pytest.mark.parametrize("shell", SHELLS, ids=lambda shell: shell[0])
def test_the_script_runs_in_any_shell(shell: list[str]) -> None:
    """The script runs without a word of error in the shells that images have, on this machine."""
    if not shutil.which(shell[0]):
        pytest.skip(f"no {shell[0]} here")
    facts = parse(run("", "/nowhere", shell=shell))
    there = {path.name for path in Path("/sys/class/net").iterdir()}
    assert set(facts.interfaces) == there - {"bonding_masters"}
    assert facts.programs == {}


@pytest.fixture
def k3s(tmp_path: Path) -> Path:
    """A root directory laid out as k3s does: absolute links into a directory with a hash."""
    cni = tmp_path / "var/lib/rancher/k3s/data/cni"
    hashed = tmp_path / "var/lib/rancher/k3s/data/0123/bin"
    cni.mkdir(parents=True)
    hashed.mkdir(parents=True)
    (hashed / "cni").touch(mode=0o755)
    (hashed / "bridge").symlink_to("cni")
    (cni / "host-local").symlink_to("/var/lib/rancher/k3s/data/0123/bin/cni")
    (cni / "bridge").symlink_to("/var/lib/rancher/k3s/data/0123/bin/bridge")
    (cni / "gone").symlink_to("/var/lib/rancher/k3s/data/4567/bin/cni")
    (cni / "macvlan").touch(mode=0o755)
    (cni / "no-program").touch(mode=0o644)
    return tmp_path


@pytest.mark.programs
def test_links_are_followed_below_the_machines_root(k3s: Path) -> None:
    """Absolute links of k3s are followed below where its root directory is mounted."""
    directory = "/var/lib/rancher/k3s/data/cni"
    facts = parse(run(str(k3s), f"{k3s}{directory}"))
    assert facts.programs == {directory: frozenset({"bridge", "host-local", "macvlan"})}


@pytest.mark.programs
def test_links_out_of_sight_are_believed(k3s: Path) -> None:
    """Where the root directory is not mounted, a link that cannot be followed counts as there."""
    directory = f"{k3s}/var/lib/rancher/k3s/data/cni"
    facts = parse(run("", directory))
    expected = {"bridge", "host-local", "macvlan", "gone"}
    assert facts.programs == {directory: frozenset(expected)}


@pytest.mark.programs
def test_a_wireless_interface_is_recognised(tmp_path: Path) -> None:
    """An interface is wireless where the kernel's directory of it has `wireless` or `phy80211`,
    or its type is; laid over /sys/class/net, since no radio is here. One that vanishes meanwhile
    is left out."""
    unshare = ["unshare", "--mount", "--map-root-user"]
    if subprocess.run([*unshare, "true"], check=False, capture_output=True).returncode:
        pytest.skip("this machine lets nobody mount")
    for name, extra in (("wlan0", "wireless"), ("wlp1s0", "phy80211"), ("wl0", ""), ("eth0", "")):
        directory = tmp_path / name
        directory.mkdir()
        if extra:
            (directory / extra).mkdir()
        for file, text in {
            "flags": "0x1003",
            "mtu": "1500",
            "uevent": f"INTERFACE={name}\n{'DEVTYPE=wlan' if name == 'wl0' else 'IFINDEX=3'}",
        }.items():
            (directory / file).write_text(f"{text}\n", "ascii")
    (tmp_path / "veth0").mkdir()
    (tmp_path / "veth0/flags").write_text("0x1003\n", "ascii")  # and then a pod ended
    script = f'mount --bind "$0" /sys/class/net && exec sh -c \'{_quoted(PROBE)}\' preflight ""'
    done = subprocess.run(
        [*unshare, "sh", "-c", script, str(tmp_path)], check=True, capture_output=True, text=True
    )
    interfaces = parse(done.stdout).interfaces
    assert {name: i.wireless for name, i in interfaces.items()} == {
        "eth0": False,
        "wl0": True,
        "wlan0": True,
        "wlp1s0": True,
    }


def _quoted(text: str) -> str:
    return text.replace("'", "'\\''")


READY = {"conditions": [{"type": "Ready", "status": "True"}]}


def pod(*containers: dict[str, Any], volumes: dict[str, str], status: Any = None) -> dict[str, Any]:
    listed = [{"name": name, "hostPath": {"path": path}} for name, path in volumes.items()]
    return {
        "metadata": {"namespace": "kube-system", "name": "multus-x"},
        "spec": {
            "nodeName": "node1",
            "containers": list(containers),
            "volumes": [*listed, {"name": "config", "configMap": {"name": "c"}}],
        },
        "status": READY if status is None else status,
    }


def container(name: str, image: str, mounts: dict[str, str], **env: str) -> dict[str, Any]:
    return {
        "name": name,
        "image": image,
        "env": [{"name": key, "value": value} for key, value in env.items()],
        "volumeMounts": [{"name": volume, "mountPath": path} for volume, path in mounts.items()]
        + [{"name": "config", "mountPath": "/etc/multus"}],
    }


OURS = pod(
    container(
        "multus",
        "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick",
        {"machine": "/hostroot", "root-0": "/var/lib/rancher/k3s"},
    ),
    container("machine", "multus-cni:1", {}, BIN_DIR="/var/lib/rancher/k3s/data/cni"),
    volumes={"machine": "/", "root-0": "/var/lib/rancher/k3s"},
)
UPSTREAM = pod(
    container(
        "kube-multus",
        "ghcr.io/k8snetworkplumbingwg/multus-cni:snapshot-thick",
        {"cni": "/host/etc/cni/net.d", "cnibin": "/opt/cni/bin", "hostroot": "/hostroot"},
    ),
    volumes={"cni": "/etc/cni/net.d", "cnibin": "/opt/cni/bin", "hostroot": "/"},
)
MICROK8S = pod(  # its addon runs the thin one
    container(
        "kube-multus",
        "ghcr.io/k8snetworkplumbingwg/multus-cni:v3.9",
        {"cni": "/host/etc/cni/net.d", "cnibin": "/host/opt/cni/bin"},
    ),
    volumes={
        "cni": "/var/snap/microk8s/current/args/cni-network",
        "cnibin": "/var/snap/microk8s/current/opt/cni/bin",
    },
)
OLD_K3S = pod(
    container(
        "kube-rke2-multus", "rancher/hardened-multus-cni:v4", {"cnibin": "/host/opt/cni/bin"}
    ),
    volumes={"cnibin": "/var/lib/rancher/k3s/data/current/bin"},
)
UNUSUAL = pod(
    container("daemon", "registry.lab/multus@sha256:00", {"host": "/host/"}), volumes={"host": "/"}
)


@pytest.mark.parametrize(
    ("made", "name", "root", "directory"),
    [
        (OURS, "multus", "/hostroot", "/hostroot/var/lib/rancher/k3s/data/cni"),
        (UPSTREAM, "kube-multus", "/hostroot", "/hostroot/opt/cni/bin"),
        (MICROK8S, "kube-multus", "", "/host/opt/cni/bin"),
        (OLD_K3S, "kube-rke2-multus", "", "/host/opt/cni/bin"),
        (UNUSUAL, "daemon", "/host/", "/host/opt/cni/bin"),
    ],
    ids=["ours", "upstream", "microk8s", "old k3s", "unusual"],
)
def test_where_the_machine_is(made: dict[str, Any], name: str, root: str, directory: str) -> None:
    """The container, the machine's root directory in it, and its CNI programs."""
    expected = Daemon("node1", "kube-system", "multus-x", name, root=root, directories=(directory,))
    assert read_daemon(made) == expected


@pytest.mark.parametrize(
    ("status", "state"),
    [
        (READY, ""),
        ({"phase": "Pending"}, "Pending"),
        ({}, "not ready"),
        (
            {
                "phase": "Running",
                "conditions": [{"type": "Ready", "status": "False"}],
                "containerStatuses": [{"state": {"waiting": {"reason": "CrashLoopBackOff"}}}],
            },
            "CrashLoopBackOff",
        ),
    ],
)
def test_why_it_is_not_ready(status: dict[str, Any], state: str) -> None:
    """The reason that Kubernetes has for it."""
    made = pod(container("multus", "multus-cni:1", {}), volumes={}, status=status)
    assert read_daemon(made).state == state


@pytest.mark.parametrize(
    ("name", "image", "expected"),
    [
        ("kube-multus-ds", "registry.lab:5000/cni:4", True),
        ("rke2-multus", "rancher/hardened-multus-cni:v4.2@sha256:00", True),
        ("rigel-whereabouts", "registry.lab/multus/whereabouts:v0.9.4", False),
        ("kube-proxy", "kube-proxy:1", False),
    ],
)
def test_which_daemon_sets_are_multus(name: str, image: str, *, expected: bool) -> None:
    """By its name or its image's, not by the registry that the image is in."""
    volumes = [{"name": "cni", "hostPath": {"path": "/etc/cni/net.d"}}]
    template = {"spec": {"containers": [{"name": "x", "image": image}], "volumes": volumes}}
    made = {"metadata": {"name": name}, "spec": {"template": template}}
    assert runs("multus", made) is expected

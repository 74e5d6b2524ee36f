"""The local cluster keeps its promises, and leaves nothing behind.

The machine is one of namespaces (see conftest.py), so what `down` leaves can be compared exactly.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import pytest

from rigel_lab.cluster import paths
from rigel_lab.cluster.components import KUBERNETES_VERSION

from .conftest import WITHIN

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(os.geteuid() != 0, reason="the local cluster needs root"),
]

#: The components of a cluster, each on one machine or on every node.
PROGRAMS = (
    *("etcd", "kube-apiserver", "kube-controller-manager", "kube-scheduler", "docker-registry"),
    *("containerd", "kubelet", "kube-proxy"),
)


@pytest.fixture(scope="module")
def one(host: Any, before: dict[str, list[str]]) -> str:
    """A cluster of two nodes."""
    host.run("mount", "-t", "tmpfs", "tmpfs", "/run/somebody")
    host.rigel("up", "--name", "t-one", "--nodes", "2")
    host.run("umount", "/run/somebody")
    return "t-one"


@pytest.fixture(scope="module")
def registry(host: Any, one: str) -> str:
    """Its registry."""
    return str(host.status(one)["registry"])


def test_ranges_in_use_are_left_alone(host: Any, one: str) -> None:
    """The machine uses 10.64.3.0/24, so the cluster takes none of 10.64.0.0/14."""
    server = host.status(one)["server"]
    assert re.fullmatch(r"https://10\.70\.0\.2:6443", server)
    # A busy API server may not answer within the two seconds that a look gives it.
    host.until(
        lambda: [node["ready"] for node in host.status(one)["nodes"]] == [True, True],
        "running cluster with two ready nodes",
    )


def test_kubernetes_is_unmodified_upstream(host: Any, one: str) -> None:
    """Server and nodes are the released version, a clean tree."""
    released = f"v{KUBERNETES_VERSION}"
    version = json.loads(host.kubectl(one, "version", "-o", "json"))["serverVersion"]
    assert (version["gitVersion"], version["gitTreeState"]) == (released, "clean")
    nodes = json.loads(host.kubectl(one, "get", "nodes", "-o", "json"))["items"]
    assert {n["status"]["nodeInfo"]["kubeletVersion"] for n in nodes} == {released}


def test_pods_on_two_nodes_reach_each_other(host: Any, one: str, registry: str) -> None:
    """A pod reaches one on another node by its address, and by a Service and its name."""
    image = f"{registry}/rigel-k8s/busybox:1"
    serve = "echo served >/tmp/index.html; exec busybox httpd -f -p 80 -h /tmp"
    host.kubectl(one, "apply", "-f", "-", text=host.pod("web", image, serve, nodeName="node1"))
    host.kubectl(one, "expose", "pod", "web", "--port=80")
    host.kubectl(one, "wait", "pod/web", "--for=condition=Ready", WITHIN)
    address = host.kubectl(one, "get", "pod/web", "-o", "jsonpath={.status.podIP}")
    service = host.kubectl(one, "get", "service/web", "-o", "jsonpath={.spec.clusterIP}")
    # The image's static busybox can only ask DNS itself: its C library loads no resolver.
    fetch = (
        "set -e; ask() { busybox nslookup web.default.svc.cluster.local; }\n"
        "named=$(ask | busybox awk '/^Address: / { print $2 }'); [ -n \"$named\" ]\n"
        f"for h in {address} {service} $named; do busybox wget -q -O - http://$h/; done"
    )
    for node in ("node2", "node1"):  # node1: a Service that leads back to the own node
        text = host.pod(f"fetch-{node}", image, fetch, nodeName=node, restartPolicy="OnFailure")
        host.kubectl(one, "apply", "-f", "-", text=text)
        assert host.wait_for_success(one, f"fetch-{node}") == "served\n" * 3


def test_pods_reach_what_is_outside(host: Any, one: str, registry: str) -> None:
    """Where the machine drops what it forwards, as Docker's does, pods still get out."""
    assert "DROP" in host.run("iptables", "-S", "FORWARD")
    fetch = f"busybox wget -q -O - http://{host.outside}:8000/hello"
    text = host.pod("out", f"{registry}/rigel-k8s/busybox:1", fetch, restartPolicy="OnFailure")
    host.kubectl(one, "apply", "-f", "-", text=text)
    assert host.wait_for_success(one, "out") == "hello from outside\n"


def test_a_loaded_archive_runs_on_every_node(host: Any, one: str) -> None:
    """After `load` of an archive, pods on all nodes run the image, which no registry has."""
    host.rigel("load", "--name", one, str(host.archive("docker.io/library/loaded:7")))
    for node in ("node1", "node2"):
        text = host.pod(f"l-{node}", "loaded:7", "echo runs", nodeName=node, restartPolicy="Never")
        host.kubectl(one, "apply", "-f", "-", text=text)
        assert host.wait_for_success(one, f"l-{node}") == "runs\n"


def test_nothing_of_others_is_held(host: Any, one: str) -> None:
    """What somebody had mounted before the cluster, and unmounted since, no node holds."""
    held = "cat /proc/[0-9]*/mountinfo 2>/dev/null | grep -c somebody || true"
    assert host.run("sh", "-c", held).strip() == "0"


def kill(host: Any, words: Sequence[str]) -> None:
    """Kill -9 each process inside whose command line has one of the words."""
    hit = [pid for pid, text in host.processes().items() if any(word in text for word in words)]
    assert hit
    host.run("sh", "-c", f"kill -9 {' '.join(hit)}", check=False)  # one may take others with it


def test_what_ends_is_started_again(host: Any, one: str) -> None:
    """Each component that is killed comes back by itself; one log has both lives."""
    kill(host, [f"/{program} " for program in PROGRAMS])
    host.until(lambda: host.status(one)["running"], "API server")
    ready = ["wait", "node", "--all", "--for=condition=Ready", WITHIN]
    host.until(lambda: "condition met" in host.kubectl(one, *ready, check=False), "nodes")
    log = host.directory / "state/clusters/t-one/node1/logs/kubelet.log"
    host.until(lambda: "starting again" in log.read_text(), "second life of a kubelet")


def test_a_lost_node_is_started_again(host: Any, one: str, registry: str) -> None:
    """`status` tells of a machine that ended, `up` starts it again, and its pods run again."""
    image = f"{registry}/rigel-k8s/busybox:1"
    text = host.pod("stays", image, "exec busybox sleep 1000", nodeName="node2")
    host.kubectl(one, "apply", "-f", "-", text=text)
    host.kubectl(one, "wait", "pod/stays", "--for=condition=Ready", WITHIN)
    kill(host, ["node2/init.sh"])
    host.until(lambda: host.status(one)["problems"] == ["node2 has ended"], "end of node2")
    told = host.rigel("up", "--name", one)
    assert "Starting node2 again" in told
    assert "Starting node1" not in told

    def restarted() -> bool:
        shown = json.loads(host.kubectl(one, "get", "pod", "stays", "-o", "json"))["status"]
        states = shown.get("containerStatuses", [])
        return any(s["restartCount"] and s["ready"] for s in states)

    host.until(restarted, "second life of the pod")


def test_two_clusters_side_by_side(host: Any, one: str) -> None:
    """A second one has ranges of its own; the end of either does not touch the other."""
    host.rigel("up", "--name", "t-one-2", "--nodes", "1")
    assert host.status("t-one-2")["server"] != host.status(one)["server"]
    host.until(lambda: host.status(one)["running"], "answer of the first one's API server")
    sleeper = host.command("nsenter", "--net=/run/netns/rigel-t-one-node1", "sleep", "1000")
    with subprocess.Popen(sleeper) as stranger:
        host.until(lambda: "sleep 1000" in host.processes().values(), "stranger")
        host.rigel("down", "--name", one)
        assert stranger.poll() is None, "down killed what it had not started"
        host.run("pkill", "-f", "sleep 1000")
    after = host.snapshot()
    assert "t-one/" not in json.dumps(after["processes"])
    host.until(lambda: host.status("t-one-2")["running"], "answer of its API server")
    assert host.kubectl("t-one-2", "get", "nodes", "-o", "name") == "node/node1\n"
    host.rigel("down", "--name", "t-one-2")


@pytest.mark.parametrize(
    "life",
    ["normal", "killed", "interrupted", pytest.param("restarted", marks=pytest.mark.slow)],
)
def test_down_leaves_nothing(host: Any, before: dict[str, list[str]], life: str) -> None:
    """Everything is as before the cluster: after a normal life, a kill -9 of every component, an
    `up` killed half way, and a restart of the machine."""
    for name in ("t-one", "t-one-2"):
        host.rigel("down", "--name", name)
    {"normal": live, "killed": be_killed, "interrupted": be_interrupted, "restarted": restart}[
        life
    ](host)
    host.rigel("down", "--name", "t-gone")
    assert host.changes(before) == {}


def live(host: Any) -> None:
    """A cluster of one node, on which a pod with a volume runs."""
    host.rigel("up", "--name", "t-gone", "--nodes", "1")
    host.kubectl(
        "t-gone", "run", "p", f"--image={host.status('t-gone')['registry']}/rigel-k8s/pause:1"
    )
    host.kubectl("t-gone", "wait", "pod/p", "--for=condition=Ready", WITHIN)


def be_killed(host: Any) -> None:
    """All processes of the cluster are killed at once; after `up` the pod runs again; once more."""
    live(host)
    kill_all(host)
    told = host.rigel("up", "--name", "t-gone")
    assert all(f"Starting {name} again" in told for name in ("control-plane", "node1"))
    ready = ["wait", "pod/p", "--for=condition=Ready", WITHIN]
    assert "condition met" in host.kubectl("t-gone", *ready)
    kill_all(host)


def kill_all(host: Any) -> None:
    """Kill -9 everything on the machine."""
    host.run("sh", "-c", "kill -9 -1", check=False)
    host.until(lambda: not host.processes(), "end of all")


def be_interrupted(host: Any) -> None:
    """`up` is killed while it starts the nodes."""
    interrupt_up(host, "Starting node1")


def interrupt_up(host: Any, step: str) -> None:
    """Kill `up` when it reports a step."""
    words = host.command(sys.executable, "-m", "rigel_k8s", "cluster", "up", "--name", "t-gone")
    with subprocess.Popen(
        words, stderr=subprocess.PIPE, text=True, env=host.environment
    ) as process:
        assert process.stderr is not None
        assert any(step in line for line in process.stderr)
        host.run("pkill", "-KILL", "-f", "rigel_k8s cluster up")


def restart(host: Any) -> None:
    """The machine restarts: what is not on disk is gone. `up` says so and makes it as it was."""
    live(host)
    state = host.directory / "state"
    kept = {path: path.read_text() for path in [*state.glob("*.json"), *state.glob("*/*/*.json")]}
    host.rigel("down", "--name", "t-gone")
    boot = paths.boot_id()
    for path, text in kept.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text.replace(boot, "an-earlier-boot"))
    assert host.status("t-gone")["problems"] == ["this machine was restarted"]
    told = host.rigel("up", "--name", "t-gone")
    assert "lost when this machine restarted" in told
    assert len(host.status("t-gone")["nodes"]) == 1

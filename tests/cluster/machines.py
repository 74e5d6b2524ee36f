"""Machines of a local cluster that lose their power or their network."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.facts import is_ready

from ..support import shared
from ..support.until import until
from .conftest import run_rigel

#: The name of a cluster of `rigel cluster` whose machines the tests may lose, instead of a new one.
GIVEN = "RIGEL_TEST_LOSE"
#: Seconds that a machine stays cut off once Kubernetes has replaced what may leave it.
AWAY = float(os.environ.get("AWAY", "30"))
#: Seconds to wait for what Kubernetes does, on a machine that may be busy.
PATIENCE = 600
#: Seconds after which Kubernetes replaces a pod that says nothing about it.
EVICTED = 300
#: The taints of a machine that Kubernetes has lost.
LOST = ("node.kubernetes.io/not-ready", "node.kubernetes.io/unreachable")
#: A Rigelfile's `tolerations` for a node that leaves such a machine after five seconds.
LEAVES = [{"key": key, "effect": "NoExecute", "seconds": 5} for key in LOST]


@contextmanager
def own_cluster(
    name: str, *, nodes: int, extras: Collection[str] = ()
) -> Iterator[tuple[str, str]]:
    """Give (name, registry) of a cluster whose machines may be lost; it ends afterwards."""
    if os.geteuid() != 0:
        pytest.skip("the local cluster needs root")
    given = os.environ.get(GIVEN)
    name = given or shared.mine(name)
    new = [] if given else ["--nodes", str(nodes)]
    if not given:
        run_rigel("cluster", "down", "--name", name)  # that of a run that was killed
    words = [word for extra in extras for word in ("--with", extra)]
    run_rigel("cluster", "up", "--name", name, *new, *words, timeout=900)
    try:
        found = run_rigel("cluster", "status", "--name", name, "-o", "json").stdout
        yield name, json.loads(found)["registry"]
    finally:
        if not given:
            run_rigel("cluster", "down", "--name", name)


def choose_machines(cluster: Any) -> tuple[str, str]:
    """Return a machine that may be lost, and the one that resolves names.

    The only pod that does so would move after five minutes, and nodes find each other by names.
    Before that all machines are up: what prefers one is started there.
    """

    def find_machines() -> set[str]:
        found = cluster.list("v1", "Node", None)
        up = all(is_ready(one) and not one["spec"].get("taints") for one in found)
        return {one["metadata"]["name"] for one in found} if up else set()

    machines = until(find_machines, "machines that are all up", PATIENCE, every=1)
    (dns,) = cluster.list("v1", "Pod", "kube-system", labels={"app.kubernetes.io/name": "coredns"})
    stays = str(dns["spec"]["nodeName"])
    return min(machines - {stays}), stays


def prefer(machine: str) -> dict[str, Any]:
    """Return the part of a Deployment whose pods start on a machine, as long as it is there."""
    term = {"key": "kubernetes.io/hostname", "operator": "In", "values": [machine]}
    preferred = [{"weight": 100, "preference": {"matchExpressions": [term]}}]
    affinity = {"nodeAffinity": {"preferredDuringSchedulingIgnoredDuringExecution": preferred}}
    return {"spec": {"template": {"spec": {"affinity": affinity}}}}


def until_away(look: Callable[[], Mapping[str, Any]], names: Collection[str]) -> None:
    """Wait until `rigel status` says of exactly these workloads that they are out of reach.

    Args:
        look: returns what `rigel status -o json` prints.
    """

    def is_true() -> bool:
        found = look()
        unready = {one["name"]: one["message"] for one in found["workloads"] if not one["done"]}
        graph = found["graph"] or {"problems": []}
        return (
            set(unready) == set(names)
            and all("Kubernetes cannot reach the machine" in text for text in unready.values())
            and found["ready"] is not bool(names)
            and {one["kind"] for one in graph["problems"]} <= {"not-looked"}
        )

    what = f"`rigel status` in which {sorted(names)} are out of reach"
    until(is_true, what, PATIENCE, every=1, last_words=look)


def lose(cluster: str, machine: str) -> None:
    """End a machine of a local cluster at once, with all that runs on it."""
    script = f"/clusters/{cluster}/{machine}/init.sh"
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it may have ended meanwhile
            if script in (entry / "cmdline").read_bytes().decode(errors="replace"):
                found.append(int(entry.name))
    assert found, f"{machine} does not run"
    os.kill(min(found), signal.SIGKILL)  # `unshare --kill-child` takes the rest along


@contextmanager
def cut_off(cluster: str, machine: str) -> Iterator[None]:
    """Take a machine of a local cluster off the network; what runs on it goes on meanwhile."""
    ip = ("ip", "netns", "exec", f"rigel-{cluster}-{machine}", "ip", "-j", "link", "show", "eth0")
    [inside] = json.loads(subprocess.run(ip, check=True, capture_output=True).stdout)
    links = json.loads(subprocess.run(("ip", "-j", "link"), check=True, capture_output=True).stdout)
    [outside] = [one["ifname"] for one in links if one["ifindex"] == inside["link_index"]]
    subprocess.run(("ip", "link", "set", outside, "down"), check=True)
    try:
        yield
    finally:
        subprocess.run(("ip", "link", "set", outside, "up"), check=True)

"""The local cluster keeps its promises, and leaves nothing behind.

Each test's machine is a set of namespaces of its own (network, processes, mounts), beside which other
clusters may run. Its only way out is a veth to a namespace that plays the Internet, and it drops what
it forwards, as machines with Docker do. So what `down` leaves can be compared exactly.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.localcluster import components, paths

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(os.geteuid() != 0, reason="the local cluster needs root"),
]

OUTSIDE = "10.64.3.1"
KUBECONFIG = {
    "apiVersion": "v1",
    "kind": "Config",
    "clusters": [{"name": "robots", "cluster": {"server": "https://192.0.2.77:6443"}}],
    "users": [{"name": "1e3", "user": {"token": "y"}}],
    "contexts": [{"name": "robots", "context": {"cluster": "robots", "user": "1e3"}}],
    "current-context": "robots",
}


class Host:
    """A machine for local clusters, in namespaces of its own."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.kubeconfig = directory / "kubeconfig"
        self.holder = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        (self.directory / "state").mkdir()
        script = self.directory / "machine.sh"
        script.write_text(
            "set -eu\n"
            "mkdir -p /var/lib/rigel-k8s\n"
            f"mount --bind {self.directory}/state /var/lib/rigel-k8s\n"
            "mount -t tmpfs tmpfs /run\n"
            "mount -t tmpfs tmpfs /opt\n"
            "ip link set lo up\n"
            "ip link add eth0 type veth peer name out mtu 1400\n"
            "ip addr add 10.64.3.4/24 dev eth0\n"
            "ip link set eth0 mtu 1400 up\n"
            f"ip route add default via {OUTSIDE}\n"
            "iptables -P FORWARD DROP\n"
            f"touch {self.directory}/made\n"
            f"exec {components.obtain(print).program('catatonit')} -P\n"
        )
        namespaces = ["--net", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
        process = subprocess.Popen(
            ["unshare", *namespaces, "--propagation", "private", "/bin/sh", "-x", str(script)]
        )
        until(lambda: (self.directory / "made").exists(), "the machine")
        return process

    @property
    def pid(self) -> int:
        """Its first process, seen from here."""
        task = Path(f"/proc/{self.holder.pid}/task/{self.holder.pid}/children")
        return int(task.read_text().split()[0])

    def connect(self) -> subprocess.Popen[bytes]:
        """Let the other end of its cable be the Internet, with a web server on port 8000."""
        served = self.directory / "served"
        served.mkdir()
        (served / "hello").write_text("hello from outside\n")
        server = [sys.executable, "-m", "http.server", "8000", "--directory", str(served)]
        process = subprocess.Popen(
            ["unshare", "--net", "sh", "-c", f"read _; exec {' '.join(server)}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until(
            lambda: (
                Path(f"/proc/{process.pid}/ns/net").stat().st_ino
                != Path("/proc/self/ns/net").stat().st_ino
            ),
            "the Internet",
        )
        self.run("ip", "link", "set", "out", "netns", f"/host/proc/{process.pid}/ns/net")
        return process

    def command(self, *words: str) -> list[str]:
        """Return a command line that runs inside."""
        return ["nsenter", "-t", str(self.pid), "-n", "-m", "-p", *words]

    def run(self, *words: str, check: bool = True, text: str | None = None) -> str:
        """Run a program inside and return what it printed."""
        environment = {**os.environ, "KUBECONFIG": str(self.kubeconfig)}
        done = subprocess.run(
            self.command(*words),
            check=False,
            input=text,
            capture_output=True,
            text=True,
            env=environment,
            timeout=300,
        )
        if check and done.returncode != 0:
            raise AssertionError(f"{' '.join(words)}:\n{done.stdout}\n{done.stderr}")
        return done.stdout + done.stderr

    def rigel(self, *words: str, check: bool = True) -> str:
        """Run `rigel cluster`."""
        return self.run(sys.executable, "-m", "rigel_k8s", "cluster", *words, check=check)

    def status(self, name: str) -> dict[str, Any]:
        """Return `rigel cluster status -o json`."""
        return dict(json.loads(self.rigel("status", "--name", name, "-o", "json", check=False)))

    def kubectl(self, name: str, *words: str, text: str | None = None, check: bool = True) -> str:
        """Run kubectl on a cluster."""
        kubectl = components.obtain(print).program("kubectl")
        return self.run(kubectl, f"--context=rigel-{name}", *words, text=text, check=check)

    def processes(self) -> dict[str, str]:
        """Return every process inside but the first and the asking ones: id -> command line."""
        lines = self.run("ps", "-e", "-o", "pid=,args=").splitlines()
        found = dict(line.strip().split(maxsplit=1) for line in lines)
        return {pid: text for pid, text in found.items() if pid != "1" and "ps -e" not in text}

    def snapshot(self) -> dict[str, Any]:
        """Return all that a cluster may leave behind."""
        return {
            "processes": sorted(self.processes().values()),
            "mounts": sorted(mounts(self.run("cat", "/proc/self/mountinfo"))),
            "namespaces": self.run("ls", "/run", "/run/netns", check=False),
            "links": sorted(i["ifname"] for i in json.loads(self.run("ip", "-j", "link"))),
            "addresses": self.run("ip", "-br", "-4", "addr"),
            "routes": self.run("ip", "route", "show", "table", "all"),
            "rules": self.run("ip", "rule"),
            "nft": self.run("nft", "list", "ruleset"),
            "cgroups": sorted(str(p) for p in Path("/sys/fs/cgroup").glob("*/rigel-t-*")),
            "sysctls": sysctls(self.run("sysctl", "-a", check=False)),
            "kubeconfig": json.loads(self.kubeconfig.read_text())
            if self.kubeconfig.read_text().startswith("{")
            else self.kubeconfig.read_text(),
            "state": sorted(map(str, (self.directory / "state").rglob("*"))),
            "mount points": self.run("find", "/opt"),
        }

    def end(self) -> None:
        """End the machine with everything on it."""
        self.holder.kill()
        self.holder.wait()


def mounts(text: str) -> list[str]:
    """Return each mount's point, type and source."""
    lines = [line.split(" - ") for line in text.splitlines()]
    return [" ".join([head.split()[4], *tail.split()[:2]]) for head, tail in lines]


def sysctls(text: str) -> dict[str, str]:
    """Return the settings that do not change by themselves."""
    moving = (
        r"fs\.(dentry|file-nr|inode|quota|aio-nr)|kernel\.(random|ns_last_pid|pty\.nr|sched_domain)"
        r"|nf_conntrack_(count|max|buckets|expect_max)|vm\.drop_caches|\.(rk\w+|veth\w+)\."
    )
    pairs = [line.partition(" = ") for line in text.splitlines()]
    return {key: value for key, _, value in pairs if value and not re.search(moving, key)}


def until(true: Callable[[], object], what: str, seconds: float = 60) -> None:
    """Wait until something is true, or say what did not come."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, f"no {what} within {seconds:.0f} s"
        time.sleep(0.1)

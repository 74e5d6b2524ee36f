"""A machine for local clusters, on which exactly what they leave can be compared.

It is a set of namespaces of its own (network, processes, mounts), beside which other clusters may
run. Its only way out is a veth to a namespace that plays the Internet, and it drops what it
forwards, as machines with Docker do.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.system.oci import architecture, digest
from rigel_lab.cluster import addons, components
from tests.support import until as waiting

OUTSIDE = "10.64.3.1"
#: Ends a program when the tests end, however they do.
WITH_US = ("setpriv", "--pdeathsig", "KILL")
PATIENCE = 240  # seconds: other clusters start beside
WITHIN = f"--timeout={PATIENCE}s"
KUBECONFIG = """# the user's own
apiVersion: v1
kind: Config
clusters: [{name: robots, cluster: {server: "https://192.0.2.77:6443"}}]
users: [{name: "1e3", user: {token: "y"}}]
contexts: [{name: robots, context: {cluster: robots, user: "1e3"}}]
current-context: robots
"""


class Host:
    """A machine for local clusters, in namespaces of its own."""

    outside = OUTSIDE

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.kubeconfig = directory / "kubeconfig"
        self.kubeconfig.write_text(KUBECONFIG)
        self.environment = {**os.environ, "KUBECONFIG": str(self.kubeconfig)}
        self.holder = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        (self.directory / "state").mkdir()
        script = self.directory / "machine.sh"
        script.write_text(
            "set -eu\n"
            "mkdir -p /var/lib/rigel-k8s\n"
            f"mount --bind {self.directory}/state /var/lib/rigel-k8s\n"
            "for m in $(grep -o ' /run/[^ ]*' /proc/self/mounts); do umount -l $m || true; done\n"
            "mount -t tmpfs tmpfs /run\n"
            "mount --make-shared /run\n"
            "mkdir /run/somebody\n"
            "echo 0 >/proc/sys/net/ipv4/ip_forward\n"
            "echo 0 >/proc/sys/net/ipv4/conf/all/accept_redirects\n"
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
            [*WITH_US, "unshare", *namespaces, "--propagation", "private", "sh", "-x", str(script)]
        )
        until((self.directory / "made").exists, "machine", process.kill)
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
            [*WITH_US, "unshare", "--net", *server],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        ours = Path("/proc/self/ns/net").stat().st_ino
        there = Path(f"/proc/{process.pid}/ns/net")
        until(lambda: there.stat().st_ino != ours, "Internet")
        commands = (
            (self.pid, ["link", "set", "out", "netns", str(process.pid)]),
            (process.pid, ["addr", "add", f"{OUTSIDE}/24", "dev", "out"]),
            (process.pid, ["link", "set", "out", "up"]),
        )
        for pid, words in commands:
            subprocess.run(["nsenter", "-t", str(pid), "-n", "ip", *words], check=True)
        return process

    def command(self, *words: str) -> list[str]:
        """Return a command line that runs inside."""
        return ["nsenter", "-t", str(self.pid), "-n", "-m", "-p", *words]

    def run(self, *words: str, check: bool = True, text: str | None = None) -> str:
        """Run a program inside and return what it printed."""
        done = subprocess.run(
            self.command(*words),
            check=False,
            input=text,
            capture_output=True,
            text=True,
            env=self.environment,
            timeout=800,
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
        kubectl = components.obtain(print, ["kubectl"]).program("kubectl")
        return self.run(kubectl, f"--context=rigel-{name}", *words, text=text, check=check)

    def processes(self) -> dict[str, str]:
        """Return every process inside but the first and the asking ones: id -> command line.

        One that has ended, and that nobody has waited for yet, is none any more.
        """
        lines = self.run("ps", "-e", "-ww", "-o", "pid=,args=").splitlines()
        found = dict(line.strip().split(maxsplit=1) for line in lines)
        others = {pid: text for pid, text in found.items() if pid != "1" and "ps -e" not in text}
        return {pid: text for pid, text in others.items() if not text.endswith("<defunct>")}

    def snapshot(self) -> dict[str, list[str]]:
        """Return all that a cluster may leave behind."""
        return {
            "processes": sorted(self.processes().values()),
            "mounts": sorted(mounts(self.run("cat", "/proc/self/mountinfo"))),
            "namespaces": self.run("find", "/run").splitlines(),
            "links": sorted(i["ifname"] for i in json.loads(self.run("ip", "-j", "link"))),
            "addresses": self.run("ip", "-br", "-4", "addr").splitlines(),
            "routes": self.run("ip", "-4", "route", "show", "table", "all").splitlines(),
            "rules": self.run("ip", "rule").splitlines(),
            "nft": self.run("nft", "list", "ruleset").splitlines(),
            "cgroups": sorted(str(p) for p in Path("/sys/fs/cgroup").glob("*/rigel-t-*")),
            "sysctls": sysctls(self.run("sysctl", "-a", check=False)),
            "kubeconfig": flat(yaml.safe_load(self.kubeconfig.read_text())),
            "state": sorted(map(str, (self.directory / "state").rglob("*"))),
            "mount points": self.run("find", "/opt").splitlines(),
        }

    def changes(self, before: dict[str, list[str]]) -> dict[str, list[str]]:
        """Return what was taken (-) and what was added (+), by what it is."""
        return changes(before, self.snapshot())

    def wait_for_success(self, cluster: str, name: str) -> str:
        """Wait for a pod's success and return what it printed."""
        words = [f"pod/{name}", "--for=jsonpath={.status.phase}=Succeeded", WITHIN]
        waited = self.kubectl(cluster, "wait", *words, check=False)
        assert "condition met" in waited, self.kubectl(cluster, "describe", "pod", name)
        return self.kubectl(cluster, "logs", name)

    def layer(self) -> Path:
        """Write the file system of an image: a shell."""
        shell = addons.own_images(components.obtain(print))[3]
        path = self.directory / "layer.tar"
        path.write_bytes(shell.layer())
        return path

    def archive(self, name: str) -> Path:
        """Write an image of a shell as `docker save` does."""
        layer = self.layer()
        rootfs = {"type": "layers", "diff_ids": [digest(layer.read_bytes())]}
        config = {"architecture": architecture(), "os": "linux", "rootfs": rootfs}
        manifest = [{"Config": "config.json", "RepoTags": [name], "Layers": [layer.name]}]
        path = self.directory / "image.tar"
        with tarfile.open(path, "w") as tar:
            for part, content in (("config.json", config), ("manifest.json", manifest)):
                data = json.dumps(content).encode()
                entry = tarfile.TarInfo(part)
                entry.size = len(data)
                tar.addfile(entry, io.BytesIO(data))
            tar.add(layer, layer.name)
        return path

    @staticmethod
    def pod(name: str, image: str, script: str, **spec: Any) -> str:
        """Return a pod that runs a shell script, as JSON."""
        container = {"name": "c", "image": image, "command": ["sh", "-c", script]}
        container |= spec.pop("container", {})
        meta = {"name": name, "labels": {"app": name}} | spec.pop("metadata", {})
        full = {"containers": [container], "terminationGracePeriodSeconds": 0, **spec}
        return json.dumps({"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": full})

    @staticmethod
    def until(true: Callable[[], object], what: str) -> None:
        """Wait until something is true, or say what did not come."""
        until(true, what)

    def end(self) -> None:
        """End the machine with everything on it."""
        self.holder.kill()
        self.holder.wait()


def mounts(text: str) -> list[str]:
    """Return each mount's point, type and source, without those of other lanes' image builds."""
    lines = [line.split(" - ") for line in text.splitlines() if "/lib/containers/" not in line]
    return [" ".join([head.split()[4], *tail.split()[:2]]) for head, tail in lines]


def flat(content: dict[str, Any]) -> list[str]:
    """Return each part of a kubeconfig as a line."""
    return [f"{key}: {json.dumps(value)}" for key, value in content.items()]


def changes(before: dict[str, list[str]], after: dict[str, list[str]]) -> dict[str, list[str]]:
    """Return what was taken (-) and what was added (+), by what it is."""
    found = {}
    for key, lines in before.items():
        gone = [f"- {line}" for line in lines if line not in after[key]]
        new = [f"+ {line}" for line in after[key] if line not in lines]
        if gone or new:
            found[key] = gone + new
    return found


def sysctls(text: str) -> list[str]:
    """Return the settings that do not change by themselves."""
    moving = (
        r"fs\.(dentry|file-nr|inode|quota|aio-nr)|kernel\.(random|ns_last_pid|pty\.nr|sched_domain)"
        r"|kernel\.(perf_event_max_sample_rate|hung_task_detect_count)"  # of a busy machine
        r"|nf_conntrack_(count|max|buckets|expect_max)|vm\.drop_caches|\.(rk\w+|veth\w+)\."
    )
    return [line for line in text.splitlines() if not re.search(moving, line)]


def until(
    true: Callable[[], object], what: str, otherwise: Callable[[], object] = lambda: None
) -> None:
    """Wait until something is true, or say what did not come."""
    waiting.until(true, what, PATIENCE, last_words=otherwise)


@pytest.fixture(scope="module")
def host(context: str) -> Iterator[Host]:
    """A machine, ended with all that is on it.

    The shared cluster is there meanwhile: what clusters set of the kernel stays as they set it.
    """
    # Not below /tmp, which may be a file system that cannot hold images.
    directory = Path("/var/lib/rigel-k8s-test", str(os.getpid()))
    directory.mkdir(parents=True)
    machine = Host(directory)
    outside = machine.connect()
    yield machine
    machine.end()
    outside.kill()
    outside.wait()
    remove_cgroups()
    shutil.rmtree(directory)
    with suppress(OSError):
        directory.parent.rmdir()


def remove_cgroups() -> None:
    """Remove what a test that failed has left."""
    for top in Path("/sys/fs/cgroup").glob("*/rigel-t-*"):
        for path in [*sorted((p for p in top.rglob("*") if p.is_dir()), reverse=True), top]:
            until(lambda path=path: try_remove(path), f"end of {path}")


def try_remove(path: Path) -> bool:
    """Remove a cgroup, and return whether its last process had ended."""
    with suppress(OSError):
        path.rmdir()
    return not path.exists()


@pytest.fixture(scope="module")
def before(host: Host) -> dict[str, list[str]]:
    """What the machine was like, without what a run that was killed has left."""
    remove_cgroups()
    return host.snapshot()

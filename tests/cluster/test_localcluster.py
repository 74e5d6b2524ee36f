"""The local cluster keeps its promises, and leaves nothing behind.

Each test's machine is a set of namespaces of its own (network, processes, mounts), beside which
other clusters may run. Its only way out is a veth to a namespace that plays the Internet, and it
drops what it forwards, as machines with Docker do. So what `down` leaves can be compared exactly.
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
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.localcluster import addons, components, oci, paths

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(os.geteuid() != 0, reason="the local cluster needs root"),
]

OUTSIDE = "10.64.3.1"
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

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.kubeconfig = directory / "kubeconfig"
        self.kubeconfig.write_text(KUBECONFIG)
        self.environment = {
            **os.environ,
            "KUBECONFIG": str(self.kubeconfig),
            "CONTAINERS_STORAGE_CONF": str(directory / "storage.conf"),
            "CONTAINERS_CONF": str(directory / "containers.conf"),
        }
        (directory / "storage.conf").write_text(
            f'[storage]\ndriver = "vfs"\ngraphroot = "{directory}/podman/graph"\n'
            f'runroot = "{directory}/podman/run"\n'
        )
        (directory / "containers.conf").write_text(
            f'[engine]\nstatic_dir = "{directory}/podman/libpod"\n'
            f'tmp_dir = "{directory}/podman/tmp"\n'
        )
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
            ["unshare", *namespaces, "--propagation", "private", "/bin/sh", "-x", str(script)]
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
            ["unshare", "--net", *server], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
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

    def end(self) -> None:
        """End the machine with everything on it."""
        self.holder.kill()
        self.holder.wait()


def mounts(text: str) -> list[str]:
    """Return each mount's point, type and source."""
    lines = [line.split(" - ") for line in text.splitlines()]
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
        r"|nf_conntrack_(count|max|buckets|expect_max)|vm\.drop_caches|\.(rk\w+|veth\w+)\."
    )
    return [line for line in text.splitlines() if not re.search(moving, line)]


def until(
    true: Callable[[], object], what: str, otherwise: Callable[[], object] = lambda: None
) -> None:
    """Wait until something is true, or say what did not come."""
    deadline = time.monotonic() + 60
    while not true():
        if time.monotonic() > deadline:
            otherwise()
            raise AssertionError(f"no {what} within a minute")
        time.sleep(0.1)


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    """A machine, ended with all that is on it."""
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
            until(lambda path=path: removed(path), f"end of {path}")


def removed(path: Path) -> bool:
    """Remove a cgroup, and return whether its last process had ended."""
    with suppress(OSError):
        path.rmdir()
    return not path.exists()


@pytest.fixture(scope="module")
def before(host: Host) -> dict[str, list[str]]:
    """What the machine was like."""
    return host.snapshot()


@pytest.fixture(scope="module")
def one(host: Host, before: dict[str, list[str]]) -> str:
    """A cluster of two nodes."""
    host.run("mount", "-t", "tmpfs", "tmpfs", "/run/somebody")
    host.rigel("up", "--name", "t-one", "--nodes", "2")
    host.run("umount", "/run/somebody")
    return "t-one"


@pytest.fixture(scope="module")
def registry(host: Host, one: str) -> str:
    """Its registry."""
    return str(host.status(one)["registry"])


def pod(name: str, image: str, script: str, **spec: Any) -> str:
    """Return a pod that runs a shell script, as JSON."""
    container = {"name": "c", "image": image, "command": ["sh", "-c", script]}
    container |= spec.pop("container", {})
    full = {"containers": [container], "terminationGracePeriodSeconds": 0, **spec}
    meta = {"name": name, "labels": {"app": name}}
    return json.dumps({"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": full})


def finished(host: Host, cluster: str, name: str) -> str:
    """Wait for a pod's success and return what it printed."""
    words = [f"pod/{name}", "--for=jsonpath={.status.phase}=Succeeded", "--timeout=60s"]
    waited = host.kubectl(cluster, "wait", *words, check=False)
    assert "condition met" in waited, host.kubectl(cluster, "describe", "pod", name)
    return host.kubectl(cluster, "logs", name)


def test_ranges_in_use_are_left_alone(host: Host, one: str) -> None:
    """The machine uses 10.64.3.0/24, so the cluster takes none of 10.64.0.0/14."""
    server = host.status(one)["server"]
    assert re.fullmatch(r"https://10\.70\.0\.2:6443", server)
    assert host.status(one)["running"]
    assert [node["ready"] for node in host.status(one)["nodes"]] == [True, True]


def test_up_again_changes_nothing(host: Host, one: str) -> None:
    """A second up finds everything and starts nothing."""
    processes = host.processes()
    assert "is running already" in host.rigel("up", "--name", one)
    assert set(processes) <= set(host.processes())


def test_another_number_of_nodes_is_refused(host: Host, one: str) -> None:
    """A running cluster keeps its nodes; that is told, with the way out."""
    told = host.rigel("up", "--name", one, "--nodes", "3", check=False)
    assert "cluster t-one has 2 nodes, not 3" in told
    assert "rigel cluster down --name t-one" in told


def test_kubernetes_is_unmodified_upstream(host: Host, one: str) -> None:
    """Server and nodes are the released version, a clean tree."""
    version = json.loads(host.kubectl(one, "version", "-o", "json"))["serverVersion"]
    assert (version["gitVersion"], version["gitTreeState"]) == ("v1.34.4", "clean")
    nodes = json.loads(host.kubectl(one, "get", "nodes", "-o", "json"))["items"]
    assert {n["status"]["nodeInfo"]["kubeletVersion"] for n in nodes} == {"v1.34.4"}


def test_pods_on_two_nodes_reach_each_other(host: Host, one: str, registry: str) -> None:
    """A pod reaches one on another node by its address, and by a Service and its name."""
    image = f"{registry}/rigel-k8s/busybox:1"
    serve = "echo served >/tmp/index.html; exec busybox httpd -f -p 80 -h /tmp"
    host.kubectl(one, "apply", "-f", "-", text=pod("web", image, serve, nodeName="node1"))
    host.kubectl(one, "expose", "pod", "web", "--port=80")
    host.kubectl(one, "wait", "pod/web", "--for=condition=Ready", "--timeout=60s")
    address = host.kubectl(one, "get", "pod/web", "-o", "jsonpath={.status.podIP}")
    service = host.kubectl(one, "get", "service/web", "-o", "jsonpath={.spec.clusterIP}")
    # The image's static busybox can only ask DNS itself: its C library loads no resolver.
    fetch = (
        "set -e; ask() { busybox nslookup web.default.svc.cluster.local; }\n"
        "named=$(ask | busybox awk '/^Address: / { print $2 }')\n"
        f"for h in {address} {service} $named; do busybox wget -q -O - http://$h/; done"
    )
    for node in ("node2", "node1"):  # node1: a Service that leads back to the own node
        text = pod(f"fetch-{node}", image, fetch, nodeName=node, restartPolicy="OnFailure")
        host.kubectl(one, "apply", "-f", "-", text=text)
        assert finished(host, one, f"fetch-{node}") == "served\n" * 3


def test_pods_reach_what_is_outside(host: Host, one: str, registry: str) -> None:
    """Where the machine drops what it forwards, as Docker's does, pods still get out."""
    assert "DROP" in host.run("iptables", "-S", "FORWARD")
    fetch = f"busybox wget -q -O - http://{OUTSIDE}:8000/hello"
    text = pod("out", f"{registry}/rigel-k8s/busybox:1", fetch, restartPolicy="OnFailure")
    host.kubectl(one, "apply", "-f", "-", text=text)
    assert finished(host, one, "out") == "hello from outside\n"


def test_a_claim_keeps_its_data(host: Host, one: str, registry: str) -> None:
    """A claim without a class binds, and a second pod reads what the first one wrote."""
    spec = {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": "1Mi"}}}
    claim = {"apiVersion": "v1", "kind": "PersistentVolumeClaim", "metadata": {"name": "data"}}
    host.kubectl(one, "apply", "-f", "-", text=json.dumps({**claim, "spec": spec}))
    volumes = {
        "volumes": [{"name": "v", "persistentVolumeClaim": {"claimName": "data"}}],
        "container": {"volumeMounts": [{"name": "v", "mountPath": "/data"}]},
        "restartPolicy": "OnFailure",
    }
    image = f"{registry}/rigel-k8s/busybox:1"
    for name, script in (("write", "echo kept >/data/file"), ("read", "cat /data/file")):
        host.kubectl(one, "apply", "-f", "-", text=pod(name, image, script, **volumes))
        told = finished(host, one, name)
        host.kubectl(one, "delete", "pod", name)
    assert told == "kept\n"


def write_layer(host: Host) -> Path:
    """Write the file system of an image: a shell."""
    layer = addons.images(components.obtain(print))[3].layer()
    path = host.directory / "layer.tar"
    path.write_bytes(layer)
    return path


def docker_archive(host: Host, name: str) -> Path:
    """Write an image as `docker save` does."""
    layer = write_layer(host).read_bytes()
    rootfs = {"type": "layers", "diff_ids": [oci.digest(layer)]}
    config = {"architecture": oci.machine_architecture(), "os": "linux", "rootfs": rootfs}
    manifest = [{"Config": "config.json", "RepoTags": [name], "Layers": ["layer.tar"]}]
    path = host.directory / "image.tar"
    with tarfile.open(path, "w") as tar:
        for part, content in (("config.json", config), ("manifest.json", manifest)):
            data = json.dumps(content).encode()
            entry = tarfile.TarInfo(part)
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
        tar.add(host.directory / "layer.tar", "layer.tar")
    return path


def test_a_loaded_archive_runs_on_every_node(host: Host, one: str) -> None:
    """After `load` of an archive, pods on all nodes run the image, which no registry has."""
    host.rigel("load", "--name", one, str(docker_archive(host, "docker.io/library/loaded:7")))
    for node in ("node1", "node2"):
        text = pod(f"l-{node}", "loaded:7", "echo runs", nodeName=node, restartPolicy="Never")
        host.kubectl(one, "apply", "-f", "-", text=text)
        assert finished(host, one, f"l-{node}") == "runs\n"


@pytest.mark.skipif(not shutil.which("podman"), reason="needs podman")
def test_an_image_of_podman_runs(host: Host, one: str) -> None:
    """After `load` of an image by its name in podman, a pod runs it."""
    host.run("podman", "import", "-q", str(write_layer(host)), "localhost/mine:3")
    host.rigel("load", "--name", one, "localhost/mine:3")
    text = pod("mine", "localhost/mine:3", "echo runs", restartPolicy="Never")
    host.kubectl(one, "apply", "-f", "-", text=text)
    assert finished(host, one, "mine") == "runs\n"


def test_load_says_which_image_nobody_has(host: Host, one: str) -> None:
    """Neither a file nor an image: both are told, exit code 2."""
    told = host.rigel("load", "--name", one, "nobody/has:this", check=False)
    assert "no file" in told
    assert "nobody/has:this" in told


def test_a_pushed_image_has_its_upstream_name(host: Host, one: str, registry: str) -> None:
    """What is pushed as REGISTRY/library/NAME is what pods call NAME; so with other registries."""
    push = (
        "import attrs, sys\n"
        "from rigel_k8s.localcluster import addons, components, oci\n"
        "shell = addons.images(components.obtain(print))[3]\n"
        "for name in sys.argv[2:]: oci.push(attrs.evolve(shell, name=name), sys.argv[1])\n"
    )
    host.run(sys.executable, "-c", push, registry, "library/pushed:1", "team/robot:2")
    for name, image in (("hub", "pushed:1"), ("quay", "quay.io/team/robot:2")):
        text = pod(name, image, "echo runs", restartPolicy="Never")
        host.kubectl(one, "apply", "-f", "-", text=text)
        assert finished(host, one, name) == "runs\n"


def test_the_registry_is_told_to_tools(host: Host, one: str, registry: str) -> None:
    """kube-public/local-registry-hosting names the registry."""
    words = ["-n", "kube-public", "get", "configmap", "local-registry-hosting", "-o", "json"]
    data = json.loads(host.kubectl(one, *words))["data"]
    assert json.loads(data["localRegistryHosting.v1"])["host"] == registry


def test_the_kubeconfig_gains_a_context(host: Host, one: str) -> None:
    """The context is there and current; kubectl still reads all that was there before."""
    shown = json.loads(host.kubectl(one, "config", "view", "-o", "json"))
    assert {c["name"] for c in shown["contexts"]} == {"robots", "rigel-t-one"}
    assert "1e3" in {u["name"] for u in shown["users"]}
    assert host.run("stat", "-c", "%a", str(host.kubeconfig)).strip() == "644"
    alone = yaml.safe_load(host.rigel("kubeconfig", "--name", one))
    assert alone["current-context"] == "rigel-t-one"


def test_nothing_of_others_is_held(host: Host, one: str) -> None:
    """What somebody had mounted before the cluster, and unmounted since, no node holds."""
    held = "cat /proc/[0-9]*/mountinfo 2>/dev/null | grep -c somebody || true"
    assert host.run("sh", "-c", held).strip() == "0"


def test_metrics_of_pods_are_counted(host: Host, one: str) -> None:
    """The kubelets know each pod's memory, as the cgroups are the nodes' own."""
    stats = json.loads(host.kubectl(one, "get", "--raw", "/api/v1/nodes/node1/proxy/stats/summary"))
    assert any(p.get("memory", {}).get("workingSetBytes") for p in stats["pods"])


def kill(host: Host, words: Sequence[str]) -> None:
    """Kill -9 each process inside whose command line has one of the words."""
    hit = [pid for pid, text in host.processes().items() if any(word in text for word in words)]
    assert hit
    host.run("sh", "-c", f"kill -9 {' '.join(hit)}", check=False)  # one may take others with it


def test_what_ends_is_started_again(host: Host, one: str) -> None:
    """Each component that is killed comes back by itself; one log has both lives."""
    programs = ("kube-apiserver", "etcd", "kubelet", "containerd", "kube-proxy", "docker-registry")
    kill(host, [f"/{program} " for program in programs])
    until(lambda: host.status(one)["running"], "API server")
    ready = ["wait", "node", "--all", "--for=condition=Ready", "--timeout=60s"]
    until(lambda: "condition met" in host.kubectl(one, *ready, check=False), "nodes")
    log = host.directory / "state/clusters/t-one/node1/logs/kubelet.log"
    assert "starting again" in log.read_text()


def test_a_lost_node_is_started_again(host: Host, one: str, registry: str) -> None:
    """`status` tells of a machine that ended, `up` starts it again, and its pods run again."""
    image = f"{registry}/rigel-k8s/busybox:1"
    text = pod("stays", image, "exec busybox sleep 1000", nodeName="node2")
    host.kubectl(one, "apply", "-f", "-", text=text)
    host.kubectl(one, "wait", "pod/stays", "--for=condition=Ready", "--timeout=60s")
    kill(host, ["node2/init.sh"])
    until(lambda: not host.status(one)["running"], "end of node2")
    assert host.status(one)["problems"] == ["node2 has ended"]
    told = host.rigel("up", "--name", one)
    assert "Starting node2 again" in told
    assert "Starting node1" not in told

    def restarted() -> bool:
        shown = json.loads(host.kubectl(one, "get", "pod", "stays", "-o", "json"))["status"]
        states = shown.get("containerStatuses", [])
        return any(s["restartCount"] and s["ready"] for s in states)

    until(restarted, "second life of the pod")


def test_two_clusters_side_by_side(host: Host, one: str) -> None:
    """A second one has ranges of its own; the end of either does not touch the other."""
    host.rigel("up", "--name", "t-one-2", "--nodes", "1")
    assert host.status("t-one-2")["server"] != host.status(one)["server"]
    assert host.status(one)["running"]
    sleeper = host.command("nsenter", "--net=/run/netns/rigel-t-one-node1", "sleep", "1000")
    with subprocess.Popen(sleeper) as stranger:
        until(lambda: "sleep 1000" in host.processes().values(), "stranger")
        host.rigel("down", "--name", one)
        assert stranger.poll() is None, "down killed what it had not started"
        host.run("pkill", "-f", "sleep 1000")
    after = host.snapshot()
    assert "t-one/" not in json.dumps(after["processes"])
    assert host.status("t-one-2")["running"]
    assert host.kubectl("t-one-2", "get", "nodes", "-o", "name") == "node/node1\n"
    host.rigel("down", "--name", "t-one-2")


@pytest.mark.parametrize("life", ["normal", "killed", "interrupted", "restarted"])
def test_down_leaves_nothing(host: Host, before: dict[str, list[str]], life: str) -> None:
    """Everything is as before the cluster: after a normal life, a kill -9 of every component, an
    `up` killed half way, and a restart of the machine."""
    for name in ("t-one", "t-one-2"):
        host.rigel("down", "--name", name)
    {"normal": live, "killed": be_killed, "interrupted": be_interrupted, "restarted": restart}[
        life
    ](host)
    host.rigel("down", "--name", "t-gone")
    assert changes(before, host.snapshot()) == {}


def live(host: Host) -> None:
    """A cluster of one node, on which a pod with a volume runs."""
    host.rigel("up", "--name", "t-gone", "--nodes", "1")
    host.kubectl(
        "t-gone", "run", "p", f"--image={host.status('t-gone')['registry']}/rigel-k8s/pause:1"
    )
    host.kubectl("t-gone", "wait", "pod/p", "--for=condition=Ready", "--timeout=60s")


def be_killed(host: Host) -> None:
    """All processes of the cluster are killed at once; after `up` the pod runs again; once more."""
    live(host)
    kill_all(host)
    told = host.rigel("up", "--name", "t-gone")
    assert all(f"Starting {name} again" in told for name in ("control-plane", "node1"))
    ready = ["wait", "pod/p", "--for=condition=Ready", "--timeout=60s"]
    assert "condition met" in host.kubectl("t-gone", *ready)
    kill_all(host)


def kill_all(host: Host) -> None:
    """Kill -9 everything on the machine."""
    host.run("sh", "-c", "kill -9 -1", check=False)
    until(lambda: not host.processes(), "end of all")


def be_interrupted(host: Host) -> None:
    """`up` is killed while it starts the nodes."""
    words = host.command(sys.executable, "-m", "rigel_k8s", "cluster", "up", "--name", "t-gone")
    with subprocess.Popen(
        words, stderr=subprocess.PIPE, text=True, env=host.environment
    ) as process:
        assert process.stderr is not None
        assert any("Starting node1" in line for line in process.stderr)
        host.run("pkill", "-KILL", "-f", "rigel_k8s cluster up")


def restart(host: Host) -> None:
    """The machine restarts: all that is not on disk is gone. `up` says so and begins anew."""
    live(host)
    state = host.directory / "state"
    kept = {path: path.read_text() for path in [*state.glob("*.json"), *state.glob("*/*/*.json")]}
    host.rigel("down", "--name", "t-gone")
    boot = paths.boot_id()
    for path, text in kept.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text.replace(boot, "an-earlier-boot"))
    assert host.status("t-gone")["problems"] == ["this machine was restarted"]
    told = host.rigel("up", "--name", "t-gone", "--nodes", "1")
    assert "lost when this machine restarted" in told

"""Real DDS in pods made of namespaces, on machines made of bridges; no Kubernetes.

A machine is a bridge in a network namespace of its own, joined to a switch; a pod has its own
network (net1 on its machine's bridge) and processes. The programs come from PyPI: rclpy with Fast
DDS, Cyclone DDS, zenoh, Fast DDS' discovery server. `Lab.run` stands where the cluster's does.
"""

from __future__ import annotations

import functools
import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import attrs
import pytest

import rigel_inpod
from rigel_graph.discovery.findings import DiscoveryGraph, graph
from rigel_graph.discovery.looks import look
from rigel_graph.discovery.members import Member
from rigel_k8s.kube.execution import ExecResult
from rigel_k8s.network.modes.peers import peer_name
from rigel_k8s.system.cache import locked
from rigel_rmw import libraries
from tests.support.ros2_c import compile_ros
from tests.support.until import until

SCRIPTS = Path(rigel_inpod.__file__).parent
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rigel-k8s" / "tests"
PACKAGES = {
    "jazzy": ["ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-std-msgs"],
    "kilted": ["ros-kilted-rclpy", "ros-kilted-rmw-fastrtps-cpp", "ros-kilted-std-msgs"],
    "dds": ["cyclonedds", "eclipse-zenoh"],
}
PACKAGES["work"] = [*PACKAGES["jazzy"], "ros-test-msgs==2.0.3"]  # an action's types
PACKAGES["work-kilted"] = [*PACKAGES["kilted"], "ros-test-msgs==2.3.0"]
#: Seconds for what starts a Python in a pod; on a busy machine it takes many.
PATIENCE = 120
_BOX = 'mount -t proc proc /proc; mount --bind "$HOSTS" /etc/hosts; exec env -i "$@"'

ROS_NODE = """
import rclpy, sys
rclpy.init()
node = rclpy.create_node(sys.argv[1])
print("up", flush=True)
rclpy.spin(node)
"""
CYCLONE = """
import time
from cyclonedds.domain import DomainParticipant
participant = DomainParticipant(0)
print("up", flush=True)
time.sleep(600)
"""

ROUTER = """
import time, zenoh
config = zenoh.Config.from_json5('{mode: "router", listen: {endpoints: ["tcp/0.0.0.0:7447"]}}')
session = zenoh.open(config)
print("up", flush=True)
time.sleep(600)
"""
CLIENT = """
import sys, time, zenoh
where = sys.argv[1]
config = zenoh.Config.from_json5('{mode: "client", connect: {endpoints: ["tcp/%s:7447"]}}' % where)
session = zenoh.open(config)
print("up", flush=True)
time.sleep(600)
"""


@attrs.define
class Pod:
    """One running pod; `init` is its process 1 as the host numbers it."""

    name: str
    machine: str
    address: str
    network: str
    process: subprocess.Popen[bytes]
    output: Path
    env: dict[str, str]
    init: int = 0

    def exec(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run a command in the pod."""
        return subprocess.run(
            self.entering(command), capture_output=True, text=True, timeout=240, check=False
        )

    def entering(self, command: Sequence[str]) -> list[str]:
        """The host's command line that runs `command` in the pod."""
        variables = [f"{k}={v}" for k, v in self.env.items() if k != "LD_PRELOAD"]
        enter = ["nsenter", f"--target={self.init}", "--mount", "--net", "--pid"]
        return [*enter, "env", "-i", *variables, *command]

    def probe(self, *words: str) -> subprocess.CompletedProcess[str]:
        """What the kubelet runs."""
        return self.exec("/bin/sh", str(SCRIPTS / "ready.sh"), *words)

    def kill(self) -> None:
        """Kill it, and return when its sockets are closed."""
        self.process.kill()
        self.process.wait()
        until(lambda: not is_alive(self.init), f"end of {self.name}")

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to process 1, from outside."""
        os.kill(self.init, number)

    def ip(self, *words: str) -> None:
        """Change the pod's network."""
        run("ip", "-n", self.network, *words)

    def deaf_to(self, *others: Pod) -> None:
        """Drop the multicast that comes from other pods."""
        for other in others:
            words = ["-A", "INPUT", "-s", other.address, "-d", "239.255.0.1", "-j", "DROP"]
            run("ip", "netns", "exec", self.network, "iptables", *words)

    def drop(self, other: Pod) -> None:
        """Drop everything that comes from another pod."""
        words = ["-A", "INPUT", "-s", other.address, "-j", "DROP"]
        run("ip", "netns", "exec", self.network, "iptables", *words)

    def log(self) -> str:
        return self.output.read_text(errors="replace")


class Lab:
    """Machines on one switch, their pods, and what a cluster's client does with them."""

    _serial = itertools.count(1)

    def __init__(self, folder: Path, cleanup: ExitStack, venv: Callable[[str], Path]) -> None:
        self.folder, self.cleanup, self.venv = folder, cleanup, venv
        self.pods: dict[str, Pod] = {}
        self.bridged: list[str] = []
        self.switch = self._netns()
        self._bridge(self.switch)
        self.machines: dict[str, str] = {}
        self.links: dict[str, str] = {}
        self._settled = 0
        self.hosts = folder / "hosts"  # what the cluster's DNS is to pods
        self.hosts.write_text("127.0.0.1 localhost\n")

    def ros(self, name: str, machine: str, distro: str = "jazzy", **env: str) -> Pod:
        """Start a ROS 2 node on Fast DDS."""
        env = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_DOMAIN_ID": "0", **env}
        return self.python(name, machine, distro, ROS_NODE, name, **env)

    def layered(self, name: str, machine: str, code: str = ROS_NODE, **env: str) -> Pod:
        """Start a ROS 2 node on Fast DDS whose process notes what passes."""
        found = libraries().get(f"rmw-{os.uname().machine}.so")
        if found is None:
            pytest.skip("the layer is not built: it needs ziglang")
        library, notes = self.folder / "layer.so", self.folder / f"notes-{name}"
        if not library.exists():  # a program has it mapped
            library.write_bytes(found)
        notes.mkdir()
        layer = {"LD_PRELOAD": str(library), "RIGEL_RMW": str(notes)}
        udp = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_DOMAIN_ID": "0"}
        return self.python(name, machine, "jazzy", code, name, **udp, **layer, **env)

    def scripts(self) -> Path:
        """Return a folder with the in-pod scripts and the layer, as a release mounts them."""
        found = libraries()
        if not found:
            pytest.skip("the layer is not built: it needs ziglang")
        folder = self.folder / "scripts"
        if not folder.exists():
            shutil.copytree(SCRIPTS, folder)
            for file, content in found.items():
                (folder / file).write_bytes(content)
        return folder

    def cyclone(self, name: str, machine: str, **env: str) -> Pod:
        """Start a participant of Cyclone DDS."""
        return self.python(name, machine, "dds", CYCLONE, **env)

    def router(self, machine: str) -> Pod:
        """Start a zenoh router."""
        return self.python("router", machine, "dds", ROUTER)

    def zenoh(self, name: str, machine: str, router: Pod) -> Pod:
        """Start a zenoh session that is a router's client."""
        return self.python(name, machine, "dds", CLIENT, router.address)

    def discovery_server(self) -> Pod:
        """Start Fast DDS' discovery server out of the wheels."""
        venv = self.venv("jazzy")
        folders = {str(path.parent) for path in venv.rglob("lib*.so*")}
        program = str(venv / "bin" / "fast-discovery-server")
        words = ("-i", "0", "-l", "0.0.0.0", "-p", "11811")
        libraries = ":".join(sorted(folders))
        return self.start("server", "one", program, *words, LD_LIBRARY_PATH=libraries)

    def python(self, name: str, machine: str, venv: str, *words: str, **env: str) -> Pod:
        """Start a Python program and wait until it says that it is up."""
        python = str(self.venv(venv) / "bin" / "python")
        pod = self.start(name, machine, python, "-c", *words, **env)
        end = time.monotonic() + PATIENCE
        while "up" not in pod.log():
            assert time.monotonic() < end, pod.log()
            assert pod.process.poll() is None, pod.log()
            time.sleep(0.05)
        return pod

    def start(self, name: str, machine: str, *command: str, **env: str) -> Pod:
        """Start a pod."""
        number = next(self._serial)
        address, network = f"10.9.0.{number % 250 + 1}", self._pod_network(machine)
        run("ip", "-n", network, "address", "add", f"{address}/24", "dev", "net1")
        output = self.folder / f"{name}-{number}.log"
        variables = {"PATH": os.environ["PATH"], "HOME": str(self.folder), **env}
        line = ["nsenter", f"--net=/run/netns/{network}", "unshare", "--mount", "--pid"]
        line += ["--propagation=private", "--fork", "--kill-child", "/bin/sh", "-c", _BOX, "sh"]
        line += [*(f"{k}={v}" for k, v in variables.items()), *command]
        with self.hosts.open("a") as file:
            file.write(f"{address} {peer_name(name)}\n")
        with output.open("w") as file:
            process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                env={**os.environ, "HOSTS": str(self.hosts)},
            )
        pod = Pod(name, machine, address, network, process, output, variables)
        self.pods[name] = pod
        self.cleanup.callback(self._end, pod)
        pod.init = child(process)
        return pod

    def run(
        self,
        namespace: str,
        pod: str,
        command: Sequence[str],
        *,
        stdin: bytes | None = None,
        **_: Any,
    ) -> ExecResult:
        """Run a command in a pod as the cluster does."""
        words = self.pods[pod].entering(list(command))
        done = subprocess.run(words, input=stdin, capture_output=True, timeout=240)
        return ExecResult(done.returncode, done.stdout, done.stderr)

    def parallel(self, function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        """Call a function for all items at the same time."""
        with ThreadPoolExecutor(max(1, len(items))) as pool:
            return list(pool.map(function, items))

    def members(self, mode: str = "macvlan", **more: Any) -> list[Member]:
        """The pods as members of a release."""
        return [self.member(pod, mode, **more) for pod in self.pods.values()]

    def member(self, pod: Pod, mode: str = "macvlan", **more: Any) -> Member:
        told = {
            "namespace": "lab",
            "pod": pod.name,
            "workload": pod.name,
            "machine": pod.machine,
            "container": "ros-node",
            "mode": mode,
            "domain": 0,
            "middleware": "",
            "interface": "net1" if mode == "macvlan" else None,
            "address": pod.address if mode == "macvlan" else None,
            "ip": pod.address,
            "servers": (),
            "own_ways": (),
            "running": True,
            "has_layer": "RIGEL_RMW" in pod.env,
        }
        return Member(**{**told, **more})

    def graph(self, mode: str = "macvlan", **more: Any) -> DiscoveryGraph:
        """What `rigel` finds out about the pods."""
        return self.graph_of(self.members(mode, **more))

    def graph_of(self, found: Sequence[Member]) -> DiscoveryGraph:
        """What `rigel` finds out about some of them."""
        self.settle()
        return graph(found, look(self, found))  # type: ignore[arg-type]

    def _pod_network(self, machine: str) -> str:
        if machine not in self.machines:
            self.machines[machine] = self._netns()
            self._bridge(self.machines[machine])
            self.links[machine] = self._cable(self.switch, self.machines[machine], bridged=True)
        network = self._netns()
        self._cable(self.machines[machine], network, bridged=False)
        return network

    def default_network(self, *pods: Pod) -> None:
        """Give pods an eth0 too, on a network of its own that carries everything."""
        bridge = self._netns()
        self._bridge(bridge)
        for number, pod in enumerate(pods, 1):
            self._cable(bridge, pod.network, bridged=False, name="eth0")
            pod.ip("address", "add", f"10.8.0.{number}/24", "dev", "eth0")

    def _cable(self, bridge: str, other: str, *, bridged: bool, name: str = "net1") -> str:
        """Join a namespace to another one's bridge; its end is `name`, or on its bridge too.

        Returns the end at the first bridge.
        """
        number = next(self._serial)
        end = f"u{number}" if bridged else name
        pair = ["type", "veth", "peer", "name", end, "netns", other]
        run("ip", "-n", bridge, "link", "add", f"v{number}", *pair)
        run("ip", "-n", bridge, "link", "set", f"v{number}", "master", "br0", "up")
        run("ip", "-n", other, "link", "set", end, *(["master", "br0"] if bridged else []), "up")
        return f"v{number}"

    def deaf(self, one: str, other: str) -> None:
        """Let the switch drop the multicast of discovery from one machine to another."""
        rules = f"""
        table bridge {one}-{other} {{
            chain drops {{
                type filter hook forward priority 0;
                iifname {self.links[one]} oifname {self.links[other]} ip daddr 239.255.0.1 drop
            }}
        }}
        """
        words = ["ip", "netns", "exec", self.switch, "nft", "-f", "-"]
        subprocess.run(words, input=rules, text=True, check=True, capture_output=True)

    def settle(self) -> None:
        """Wait until all bridges forward: a new port is noticed up to a second late. Once only."""
        if self._settled == len(self.pods):
            return
        self._settled = len(self.pods)
        end = time.monotonic() + PATIENCE
        for network in self.bridged:
            while any(port["state"] != "forwarding" for port in ports(network)):
                assert time.monotonic() < end, f"{network} does not forward"
                time.sleep(0.05)

    def _bridge(self, network: str) -> None:
        self.bridged.append(network)
        run("ip", "-n", network, "link", "add", "br0", "type", "bridge", "mcast_snooping", "0")
        run("ip", "-n", network, "link", "set", "br0", "up")

    def _netns(self) -> str:
        name = f"dds{os.getpid()}n{next(self._serial)}"
        run("ip", "netns", "add", name)
        self.cleanup.callback(run, "ip", "netns", "delete", name)
        run("ip", "-n", name, "link", "set", "lo", "up")
        return name

    @staticmethod
    def _end(pod: Pod) -> None:
        pod.process.kill()
        pod.process.wait()


def ports(network: str) -> list[dict[str, Any]]:
    """The ports of a namespace's bridge."""
    done = subprocess.run(["bridge", "-n", network, "-j", "link"], check=True, capture_output=True)
    return json.loads(done.stdout)  # type: ignore[no-any-return]


def run(*words: str) -> None:
    subprocess.run(words, check=True, capture_output=True, text=True)


def child(process: subprocess.Popen[bytes]) -> int:
    """The one child of `unshare --fork`: the pod's process 1."""
    path = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        found = path.read_text().split() if path.exists() else []
        if found and b"mount" not in Path(f"/proc/{found[0]}/cmdline").read_bytes():
            return int(found[0])
        time.sleep(0.01)
    raise AssertionError(f"the pod did not start (exit code {process.poll()})")


def is_alive(process: int) -> bool:
    """Whether a process has not ended, or has and still closes its files."""
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] not in ("Z", "X")


def environment(name: str) -> Path:
    """A virtual environment with DDS programs from PyPI, kept for the next run."""
    place = CACHE / f"{name}-{sys.version_info[0]}.{sys.version_info[1]}"
    with locked(place.with_name(f"{place.name}.lock")):
        if not (place / "complete").exists():
            shutil.rmtree(place, ignore_errors=True)
            run(sys.executable, "-m", "venv", str(place))
            run(str(place / "bin" / "pip"), "install", "--quiet", *PACKAGES[name])
            (place / "complete").touch()
    return place


@pytest.fixture(scope="session")
def venv() -> Callable[[str], Path]:
    """What gives an environment by its name."""
    if os.geteuid() != 0:
        pytest.skip("pods of namespaces need root")
    tools = [
        tool for tool in ("ip", "nsenter", "unshare", "iptables", "nft") if not shutil.which(tool)
    ]
    if tools:
        pytest.skip(f"pods of namespaces need {', '.join(tools)}")

    return environment


@pytest.fixture(scope="session")
def program(
    venv: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str, str], Path]:
    """What gives a program of ros2_c by the distribution and its name."""
    room = tmp_path_factory.mktemp("ros2_c")
    return functools.cache(lambda distro, name: compile_ros(venv(distro), room, distro, name))


@pytest.fixture
def lab(venv: Callable[[str], Path], tmp_path: Path) -> Iterator[Lab]:
    """A laboratory of its own for each test; everything ends with the test."""
    with ExitStack() as cleanup:
        yield Lab(tmp_path, cleanup, venv)

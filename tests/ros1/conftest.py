"""Real ROS 1 in pods made of namespaces: what a Kubernetes pod is, without a Kubernetes.

A pod has its own network (on a bridge in a namespace of its own, the machine's network is not
touched), processes, mounts and host name; its root is the ROS 1 base image. `start` is the
container's start, `exec` is what `kubectl exec`, probes and hooks do, `terminate` is what the
kubelet does.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import subprocess
import tarfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, TypeVar

import attrs
import pytest

import rigel_inpod
from rigel_gate.program import program
from rigel_k8s.app.generations.ros1.gate import LOOPBACK, PACKAGE_PATH, PROGRAM_PATH, ROSCORE_PATH
from rigel_k8s.app.generations.ros1.master import MASTER_OPTIONS, ROSCORE
from rigel_k8s.cli.reports import Lines
from rigel_k8s.objects.pods import MASTER_PORT, ROSCORE_PORT
from rigel_k8s.system.cache import locked
from rigel_lab.images.ros1base import BaseImage, build
from tests.support.until import until

T = TypeVar("T")

SCRIPTS = Path(rigel_inpod.__file__).parent
#: Seconds for what starts a Python in a pod; on a busy machine it takes many.
PATIENCE = 120
WAIT = ("--wait", str(PATIENCE))
NODE = ("/bin/sh", "/rigel-k8s/ready.sh", "node")
MASTER = ("/bin/sh", "/rigel-k8s/ready.sh", "master")
STOP = ("/bin/sh", "/rigel-k8s/stop.sh")

_BOX = """
set -e
mount -t overlay overlay -o "lowerdir=$LOWER,upperdir=$BOX/upper,workdir=$BOX/work" "$BOX/root"
cd "$BOX/root"
mount -t proc proc proc
mount --rbind /dev dev
mount -t tmpfs tmpfs dev/shm
mkdir -p rigel-k8s
mount --bind "$SCRIPTS" rigel-k8s
mount -o remount,bind,ro rigel-k8s
hostname "$NAME"
printf '127.0.0.1 localhost\\n%s %s\\n' "$ADDRESS" "$NAME" >etc/hosts
exec chroot . env -i "$@"
"""


@attrs.define
class Pod:
    """One running pod; `init` is its process 1 as the host numbers it."""

    name: str
    address: str
    env: Mapping[str, str]
    process: subprocess.Popen[str]
    output: Path
    init: int = 0

    def exec(
        self, *command: str, env: Mapping[str, str] | None = None, timeout: float = 240
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in the container as `kubectl exec` does: no entry point, the pod's env."""
        return subprocess.run(
            self.entering(*command, env=env),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=timeout,
            check=False,
        )

    def entering(self, *command: str, env: Mapping[str, str] | None = None) -> list[str]:
        """The host's command line that runs `command` in the container."""
        variables = [f"{k}={v}" for k, v in {**self.env, **(env or {})}.items()]
        enter = ["nsenter", f"--target={self.init}", "--mount", "--net", "--pid", "--ipc", "--uts"]
        return [*enter, "--root", "--wd", "env", "-i", *variables, *command]

    def probe(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run the readiness probe once."""
        return self.exec(*NODE, *arguments)

    def pids(self, word: str) -> list[int]:
        """The host's process ids in this pod whose command line has a word."""
        mark = Path(f"/proc/{self.init}/ns/pid").readlink()
        return [
            int(folder.name)
            for folder in Path("/proc").glob("[0-9]*")
            if _link(folder / "ns/pid") == mark and word in _text(folder / "cmdline")
        ]

    def signal(self, word: str, number: signal.Signals) -> None:
        """Send a signal to the processes whose command line has a word."""
        found = self.pids(word)
        assert found, f"no process with {word!r} in {self.name}"
        for pid in found:
            os.kill(pid, number)

    def alive(self) -> bool:
        return self.process.poll() is None

    def log(self) -> str:
        return self.output.read_text()

    def kill(self) -> None:
        """The container is gone at once, as after a crash of the machine."""
        # A process that took another user's identity does not die with `unshare`.
        if self.init and self.alive():
            with suppress(ProcessLookupError):
                os.kill(self.init, signal.SIGKILL)
        self.process.kill()
        self.process.wait()

    def terminate(self, grace: float = 30) -> float:
        """What the kubelet does: the preStop hook, SIGTERM, and SIGKILL after the grace period.

        Returns the seconds until the container had ended.
        """
        started = time.monotonic()
        with suppress(subprocess.TimeoutExpired):  # the grace period ends the hook, too
            self.exec(*STOP, timeout=grace)
        with suppress(ProcessLookupError):
            os.kill(self.init, signal.SIGTERM)
        while self.alive() and time.monotonic() - started < grace:
            time.sleep(0.02)
        took = time.monotonic() - started
        self.kill()
        return took


def _link(path: Path) -> Path | None:
    try:
        return path.readlink()
    except OSError:
        return None


def _text(path: Path) -> str:
    try:
        return path.read_text().replace("\0", " ")
    except OSError:
        return ""


class Pods:
    """Pods that reach each other, and the ROS master they share."""

    _serial = itertools.count(1)

    def __init__(self, rootfs: Path, folder: Path, cleanup: ExitStack) -> None:
        self.rootfs, self.folder, self.cleanup = rootfs, folder, cleanup
        self.hub = f"rk{os.getpid()}h{next(self._serial)}"
        self.addresses = (f"10.123.0.{n}" for n in range(2, 250))
        self._netns(self.hub)
        self._ip("-n", self.hub, "link", "add", "br0", "type", "bridge")
        self._ip("-n", self.hub, "link", "set", "br0", "up")
        self.master_uri = ""
        self.networks: dict[str, str] = {}

    def roscore(self) -> Pod:
        """Start what an application has, and wait until it answers."""
        return self._master(*ROSCORE)

    def rosmaster(self) -> Pod:
        """Start what most tests need of a roscore, in half the time: no roslaunch, no /rosout."""
        return self._master("rosmaster", "--core", *MASTER_OPTIONS)

    def gated(self, *options: str) -> tuple[Pod, Pod]:
        """Start roscore behind a gate, as the ros-master pod has them; return (gate, roscore)."""
        address = next(self.addresses)
        gate = self.gate(address, *options)
        self.master_uri = f"http://{address}:{MASTER_PORT}"
        roscore = self.behind(gate)
        done = gate.exec(*MASTER, *WAIT)
        assert done.returncode == 0, done.stdout + gate.log() + roscore.log()
        return gate, roscore

    def gate(self, address: str, *options: str) -> Pod:
        """Start a gate alone."""
        own = {f"{PACKAGE_PATH}/{name}": text for name, text in program().items()}
        return self.start(
            "ros-master",
            *("python3", "-m", "rigel_gate", "--journal", "/tmp/gate", *options),
            address=address,
            files=own,
            env={"PYTHONPATH": PROGRAM_PATH, "ROS_MASTER_URI": f"http://localhost:{MASTER_PORT}"},
            entrypoint=False,
        )

    def behind(self, gate: Pod) -> Pod:
        """Start roscore behind a gate."""
        own = [word.replace("$(ROS_IP)", gate.address) for word in LOOPBACK]
        return self.start(
            "roscore",
            *(*own, *ROSCORE, "-p", str(ROSCORE_PORT)),
            beside=gate,
            env={"ROS_MASTER_URI": f"http://localhost:{MASTER_PORT}"},
            files={f"{ROSCORE_PATH}/roscore.xml": program()["roscore.xml"]},
        )

    def _master(self, *command: str) -> Pod:
        address = next(self.addresses)
        self.master_uri = f"http://{address}:11311"
        return self.answering(self.start("ros-master", *command, address=address))

    def answering(self, pod: Pod) -> Pod:
        done = pod.exec(*MASTER, *WAIT)
        assert done.returncode == 0, done.stdout + pod.log()
        return pod

    def node(self, name: str, *command: str, **options: object) -> Pod:
        """Start a pod and wait until its probe says ready."""
        pod = self.start(name, *command, **options)  # type: ignore[arg-type]
        done = pod.probe(*WAIT)
        assert done.returncode == 0, done.stdout + pod.log()
        return pod

    def start(
        self,
        name: str,
        *command: str,
        address: str = "",
        beside: Pod | None = None,
        env: Mapping[str, str] | None = None,
        files: Mapping[str, str | bytes] | None = None,
        entrypoint: bool = True,
    ) -> Pod:
        """Start a pod; `beside` another one means in its network, as host networking does.

        `files` are put into its root first; `entrypoint` runs the image's.
        """
        box = self.folder / f"{name}-{next(self._serial)}"
        for part in ("upper", "work", "root"):
            (box / part).mkdir(parents=True)
        for path, text in (files or {}).items():
            _put(box / "upper" / path.lstrip("/"), text)
        address = beside.address if beside else address or next(self.addresses)
        network = f"/proc/{beside.init}/ns/net" if beside else self._network(address)
        variables = self._env(address, env or {})
        if entrypoint:
            command = ("/ros_entrypoint.sh", *command)
        process = self._spawn(box, name, address, network, variables, command)
        pod = Pod(name, address, variables, process, box / "output")
        self.cleanup.callback(pod.kill)
        pod.init = _child(process)
        return pod

    def is_registered(self, pod: Pod, name: str) -> bool:
        """Whether the master knows a node, as another pod's rosnode sees it."""
        done = pod.exec("/bin/sh", "/rigel-k8s/exec.sh", "rosnode", "list")
        assert done.returncode == 0, done.stdout
        return name in done.stdout.split()

    def iptables(self, pod: Pod, *words: str) -> None:
        """Change what a pod's address lets through."""
        enter = ["nsenter", f"--net={self.networks[pod.address]}"]
        subprocess.run([*enter, "iptables", *words], check=True)

    def _env(self, address: str, more: Mapping[str, str]) -> dict[str, str]:
        path = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
        image = {"PATH": path, "LANG": "C.UTF-8", "ROS_DISTRO": "noetic", "HOME": "/root"}
        pod = {
            "ROS_IP": address,
            "ROS_MASTER_URI": self.master_uri,
            "PYTHONUNBUFFERED": "1",
            "PROMPT_COMMAND": ". /rigel-k8s/rc.sh",
        }
        return {**image, **pod, **more}

    def _spawn(
        self,
        box: Path,
        name: str,
        address: str,
        network: str,
        env: Mapping[str, str],
        command: tuple[str, ...],
    ) -> subprocess.Popen[str]:
        own = {"LOWER": str(self.rootfs), "BOX": str(box), "SCRIPTS": str(SCRIPTS)}
        inside = [f"{key}={value}" for key, value in env.items()]
        line = ["nsenter", f"--net={network}", "unshare", "--mount", "--propagation=private"]
        line += ["--pid", "--ipc", "--uts", "--fork", "--kill-child"]
        line += ["/bin/sh", "-c", _BOX, "sh", *inside, *command]
        with (box / "output").open("w") as output:
            return subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                text=True,
                env={**os.environ, **own, "NAME": name, "ADDRESS": address},
            )

    def _network(self, address: str) -> str:
        """The network of an address; who comes after a dead pod gets its network, as a Service."""
        if address not in self.networks:
            self.networks[address] = self._new_network(address)
        return self.networks[address]

    def _new_network(self, address: str) -> str:
        number = next(self._serial)
        name = f"rk{os.getpid()}p{number}"
        self._netns(name)
        pair = ["link", "add", f"v{number}", "type", "veth", "peer", "name", "eth0", "netns", name]
        self._ip("-n", self.hub, *pair)
        self._ip("-n", self.hub, "link", "set", f"v{number}", "master", "br0", "up")
        self._ip("-n", name, "address", "add", f"{address}/24", "dev", "eth0")
        self._ip("-n", name, "link", "set", "eth0", "up")
        self._ip("-n", name, "link", "set", "lo", "up")
        return f"/run/netns/{name}"

    def _netns(self, name: str) -> None:
        self._ip("netns", "add", name)
        self.cleanup.callback(self._ip, "netns", "delete", name)

    @staticmethod
    def _ip(*arguments: str) -> None:
        subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)


def _put(path: Path, content: str | bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    path.chmod(0o755)


def _child(process: subprocess.Popen[str]) -> int:
    """The one child of `unshare --fork`, once it has become the container's own command."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline and process.poll() is None:
        found = _text(children).split()
        if found and _link(Path(f"/proc/{found[0]}/root")) not in (None, Path("/")):
            return int(found[0])
        time.sleep(0.01)
    raise AssertionError(f"the container did not start (exit code {process.poll()})")


def unpack(archive: Path, target: Path) -> None:
    """Write an image's root file system to a directory."""
    with tarfile.open(archive) as image:
        index = image.extractfile("manifest.json")
        assert index is not None
        for layer in json.load(index)[0]["Layers"]:
            with tarfile.open(fileobj=image.extractfile(layer)) as files:
                files.extractall(target, filter="fully_trusted")


@pytest.fixture(scope="session")
def base_image() -> BaseImage:
    """The ROS 1 base image's archive, built where the cache lacks it."""
    if os.geteuid() != 0:
        pytest.skip("pods of namespaces need root")
    missing = [tool for tool in ("ip", "nsenter", "unshare") if not shutil.which(tool)]
    if missing:
        pytest.skip(f"pods of namespaces need {', '.join(missing)} (Debian: iproute2, util-linux)")
    return build(Lines())


@pytest.fixture(scope="session")
def rootfs(base_image: BaseImage) -> Path:
    """The base image's root file system; pods write above it."""
    return unpack_root(base_image)


def unpack_root(base_image: BaseImage) -> Path:
    """Return the root file system of the base image, unpacked once for all runs."""
    target = base_image.archive.with_suffix(".root")
    with locked(target.with_suffix(".unpacking")):
        if base_image.built:
            shutil.rmtree(target, ignore_errors=True)
        if not target.exists():
            partial = target.with_suffix(".partial")
            shutil.rmtree(partial, ignore_errors=True)
            unpack(base_image.archive, partial)
            partial.rename(target)
    return target


@pytest.fixture
def pods(rootfs: Path, tmp_path: Path) -> Iterator[Pods]:
    """An empty network for pods; everything in it ends with the test."""
    with ExitStack() as cleanup:
        yield Pods(rootfs, tmp_path, cleanup)


@pytest.fixture
def eventually() -> Callable[..., Any]:
    """Wait until a condition holds, and return its answer; fails with what was awaited."""

    def wait(condition: Callable[[], T], what: str, seconds: float = PATIENCE) -> T:
        return until(condition, what, seconds)

    return wait


@pytest.fixture(scope="session")
def nodelet(
    tmp_path_factory: pytest.TempPathFactory, base_image: BaseImage
) -> dict[str, str | bytes]:
    """The files of a package with a nodelet."""
    from .nodelets import make_package  # it takes what is above from here

    return make_package(tmp_path_factory.mktemp("devel"))

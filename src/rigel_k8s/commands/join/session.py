"""`rigel join`: a pod with a relay, and the program here that has its place in the network."""

from __future__ import annotations

import io
import json
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import BinaryIO, cast

import attrs

from rigel_k8s import signals
from rigel_k8s.app.development import NAME, SCRIPT, make_pod, put_to_sleep
from rigel_k8s.commands.join import inside
from rigel_k8s.commands.join.link import Link
from rigel_k8s.commands.pods import check_script, pods_of, release_pods
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import ClusterError, RigelK8sError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release import development
from rigel_k8s.release.locking import name_user, timestamp
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.rollout.causes import explain_pod
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings

LOOK = 0.1  # seconds between two looks at what goes on
#: Seconds in which the pod starts, and then its relay.
START, ANSWER = 60.0, 60.0
#: Seconds that a program has to end when its network has gone.
LEAVE = 5.0
WITHOUT_ROOT = (
    "Ubuntu allows that to root alone: `sudo -E rigel join ...`, or"
    " `sudo sysctl -w kernel.apparmor_restrict_unprivileged_userns=0`"
)


def join(
    settings: Settings,
    command: Sequence[str],
    report: Reporter,
    *,
    like: str | None = None,
    replaced: str | None = None,
    job: str | None = None,
) -> int:
    """Run a program of this computer in a release's network, and return its exit code.

    Args:
        command: empty for a shell.
        like: the node whose image and network the pod has; None for any.
        replaced: a node that does not run meanwhile.

    Raises:
        UserError: this computer cannot, or there is no such node, or it has no network of its own.
        ClusterError: the pod is refused or does not start, or the connection has ended.
        RolloutFailed: the replaced node does not become ready again.
    """
    check_computer()
    node = replaced or like
    found = release(settings, job, [node] if node else [])
    with found.cluster as cluster, ExitStack() as opened:
        check_script(found, "join.py", "joined")
        deployment = find_deployment(found, node)
        if replaced and pods_of(found, replaced)[0].shared:
            raise UserError(f"{replaced} shares its pod with other nodes, which would stop, too")
        remove_ended(found)
        pod = make_pod(deployment, f"{NAME}-{secrets.token_hex(4)}", by=name_user())
        opened.enter_context(running(cluster, pod, settings.timeout or START, report))
        if replaced:
            options = DeployOptions.of(settings, report, threading.Event())
            opened.enter_context(asleep(found, ref_of(deployment), replaced, options))
        return Session(cluster, ref_of(pod), report).run(command)


def check_computer() -> None:
    """Raise UserError if this computer has no network namespaces or no interfaces for them."""
    if sys.platform != "linux":
        raise UserError(
            "`rigel join` needs Linux, for a network namespace",
            hint="run it in a container: docker run -it --privileged -v ~/.kube:/root/.kube ...",
        )
    if not shutil.which("unshare"):
        raise UserError("unshare is not installed", hint="install util-linux")
    if not Path("/dev/net/tun").exists():
        raise UserError("there is no /dev/net/tun", hint="sudo modprobe tun")


def find_deployment(found: Release, node: str | None) -> Manifest:
    """Return the Deployment of a node, or of the first one that has our scripts.

    Without `node`, one with a ROS name is preferred: others are anonymous, or not of ROS.
    """
    every = pods_of(found, node) if node else [p for p in release_pods(found) if not p.helper]
    pods = every if node else [pod for pod in every if not pod.once]
    for pod in sorted(pods, key=lambda one: not one.ros_name):
        live = found.cluster.get(pod.find_deployment("joined"))
        if pod.scripts and live is not None:
            return live
    what = f"{node} is no node" if node else f"{found.id.name} has no node"
    raise UserError(f"{what} whose network can be joined", hint="see the nodes with `rigel status`")


def remove_ended(found: Release) -> None:
    """Delete pods that a computer has left behind: they have ended by themselves."""
    labels = {NAME_LABEL: NAME, RELEASE_LABEL: found.id.name}
    for pod in found.cluster.list("v1", "Pod", found.id.namespace, labels=labels):
        if pod["status"].get("phase") in ("Succeeded", "Failed"):
            found.cluster.delete(ref_of(pod))


@contextmanager
def running(cluster: Cluster, pod: Manifest, limit: float, report: Reporter) -> Iterator[None]:
    """Create a Pod, wait until it runs, and delete it in the end.

    Raises:
        ClusterError: it is refused, or does not run within `limit` seconds.
    """
    ref = ref_of(pod)
    try:
        cluster.create(pod)
    except Forbidden as error:
        if error.ground != "pod-security":
            raise
        raise ClusterError(
            f"the namespace {ref.namespace} forbids a pod that may send frames (NET_ADMIN)",
            hint="without that, connect single ports with `rigel forward`: of a Foxglove bridge,"
            " or of a zenoh router",
        ) from error
    try:
        deadline = time.monotonic() + limit
        while (live := cluster.get(ref)) is None or live["status"].get("phase") != "Running":
            if live is None or time.monotonic() > deadline:
                causes = [cause.message for cause in explain_pod(live, ())] if live else []
                raise ClusterError(f"{ref} does not run after {limit:g} s", details=causes)
            time.sleep(LOOK)
        yield
    finally:
        try:
            cluster.delete(ref, grace_seconds=0)
        except ClusterError as error:
            report.warn(f"{ref} is left, and ends by itself: {error}")


@contextmanager
def asleep(found: Release, ref: ObjectRef, node: str, options: DeployOptions) -> Iterator[None]:
    """Let a node have no pod; then it has one again, and is ready.

    Raises: as development.changed.
    """
    note = f"{node} is replaced by a program of {name_user()} since {timestamp()}"
    change = partial(put_to_sleep, note=note)
    labels = {NAME_LABEL: ref.name}
    with development.changed(found.cluster, found.id, ref, note, change, options):
        options.report.line(f"{node} stops")
        deadline = time.monotonic() + options.limit
        while list_pods(found.cluster, found.id, labels):
            if time.monotonic() > deadline:
                raise ClusterError(f"{node} has not stopped after {options.limit:g} s")
            time.sleep(LOOK)
        yield


@attrs.frozen
class Session:
    """A pod, its relay, and the program here."""

    cluster: Cluster
    ref: ObjectRef
    report: Reporter
    link: Link = attrs.field(factory=Link)
    errors: io.BytesIO = attrs.field(factory=io.BytesIO)
    over: threading.Event = attrs.field(factory=threading.Event)

    def run(self, command: Sequence[str]) -> int:
        """Run the program, and return its exit code."""
        threading.Thread(target=self.relay, daemon=True).start()
        deadline = time.monotonic() + ANSWER
        while not self.link.begun.wait(LOOK):
            if self.over.is_set() or time.monotonic() > deadline:
                said = self.errors.getvalue().decode("utf-8", "replace").strip().splitlines()
                raise ClusterError("the pod's relay does not answer", details=said[-3:])
        with tempfile.TemporaryDirectory(prefix="rigel-join-") as folder:
            return self.run_inside(command, folder)

    def relay(self) -> None:
        """Run the relay in the pod until one side ends."""
        place = self.ref.namespace or "", self.ref.name
        line = ["/bin/sh", f"{SCRIPTS_PATH}/exec.sh", "python3", SCRIPT]
        try:
            with os.fdopen(self.link.stdin, "rb") as stdin:
                self.cluster.exec(
                    *place,
                    line,
                    stdin=stdin,
                    stdout=cast(BinaryIO, self.link),
                    stderr=self.errors,
                    container=NAME,
                )
        except (RigelK8sError, OSError) as error:
            self.errors.write(str(error).encode())
        finally:
            self.over.set()

    def run_inside(self, command: Sequence[str], folder: str) -> int:
        """Run the program in namespaces of its own."""
        ours, theirs = socket.socketpair()
        words = [*enter(), sys.executable, "-I", inside.__file__, str(theirs.fileno())]
        program = [*back(), *(command or [os.environ.get("SHELL", "/bin/sh")])]
        with ours, theirs:
            child = subprocess.Popen([*words, *program], pass_fds=[theirs.fileno()])
            theirs.close()
            interfaces = self.hand_over(ours, folder)
            if not interfaces:
                child.wait()
                raise UserError("no network namespace could be made here", hint=WITHOUT_ROOT)
            return self.attend(child, ours, interfaces)

    def hand_over(self, ours: socket.socket, folder: str) -> list[int]:
        """Describe the pod's network, and return the descriptors of its interfaces here."""
        try:
            ours.sendall(json.dumps({**self.link.network, "here": folder}).encode() + b"\n")
            _, interfaces, _, _ = socket.recv_fds(ours, 1, 16)
        except OSError:
            return []
        return list(interfaces)

    def attend(
        self, child: subprocess.Popen[bytes], ours: socket.socket, interfaces: list[int]
    ) -> int:
        """Let the program run, carry its frames, and return its exit code."""

        def end(number: int, _: FrameType | None) -> None:
            # A terminal sends Ctrl-C to the program, too, where it may mean a part of it only.
            if number == signal.SIGTERM or not sys.stdin.isatty():
                child.send_signal(number)

        signals.handle(end)
        carrying = threading.Thread(target=self.link.carry, args=(interfaces,), daemon=True)
        carrying.start()
        addresses = ", ".join(
            f"{one['address']} ({one['name']})" for one in self.link.network["interfaces"]
        )
        self.report.line(f"joined as {addresses}")
        ours.sendall(b".")
        while (code := poll(child)) is None:
            if self.over.is_set():
                child.terminate()
                if poll(child, LEAVE) is None:
                    child.kill()
                raise ClusterError("the connection to the pod has ended")
        self.link.end()
        carrying.join(LEAVE)
        for interface in interfaces:
            os.close(interface)
        return code if code >= 0 else 128 - code


def poll(child: subprocess.Popen[bytes], seconds: float = LOOK) -> int | None:
    """Return the exit code of a program as soon as it has ended, None if it runs on."""
    try:
        return child.wait(seconds)
    except subprocess.TimeoutExpired:
        return None


def enter() -> list[str]:
    """Return the program that makes the namespaces."""
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    return ["unshare", *user, "--net", "--mount", "--"]


def back() -> list[str]:
    """Return the program that makes the user the one they were; root needs none."""
    if os.geteuid() == 0:
        return []
    return ["unshare", "--user", f"--map-user={os.getuid()}", f"--map-group={os.getgid()}", "--"]

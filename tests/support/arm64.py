"""Machines of a local cluster that have ARM processors, as far as containers can see: emulated.

containerd decides which platform of an image a machine gets. Compiled for arm64 it runs under QEMU,
so it chooses as on a robot, and the kernel gives each program of an arm64 image to QEMU.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rigel_k8s.system.cache import cache_dir, locked
from rigel_lab.cluster.commands import run
from rigel_lab.cluster.components import BUILDS, obtain
from rigel_lab.cluster.gobuild import toolchain
from rigel_lab.cluster.paths import STATE

from .until import until

CONTAINERD = BUILDS["containerd"]

BINFMT = Path("/proc/sys/fs/binfmt_misc")
#: Debian's line for its qemu-user-static; with F the kernel opens QEMU now, not inside a container.
LINE = Path("/usr/lib/binfmt.d/qemu-aarch64.conf")
#: Not Debian's name, by which the build jobs of other tests would see that arm64 runs here.
OWN = "rigel-aarch64"


def possible() -> bool:
    """Return whether Debian's qemu-user-static and arch-test are installed."""
    return LINE.exists() and shutil.which("arch-test") is not None


@contextmanager
def emulated() -> Iterator[None]:
    """Let this machine's kernel run arm64 programs for a time."""
    if not (BINFMT / "register").exists():
        run(["mount", "-t", "binfmt_misc", "binfmt_misc", str(BINFMT)])
    ours = not (BINFMT / "qemu-aarch64").exists() and not (BINFMT / OWN).exists()
    if ours:
        line = LINE.read_bytes().strip().replace(b":qemu-aarch64:", f":{OWN}:".encode(), 1)
        (BINFMT / "register").write_bytes(line)
    try:
        yield
    finally:
        if ours:
            (BINFMT / OWN).write_text("-1")


def build_containerd() -> Path:
    """Return the local cluster's containerd, compiled for arm64."""
    place = cache_dir() / f"arm64-{CONTAINERD.key()}"
    with locked(place.with_suffix(".lock")):
        if not place.exists():
            go, environment = toolchain(print)
            words = [go, "build", *CONTAINERD.flags(), "-o", str(place), CONTAINERD.packages[0]]
            run(words, cwd=CONTAINERD.lock, env={**environment, "GOARCH": "arm64"})
    return place


def change(name: str, machine: str, kubectl: str) -> None:
    """Make a machine of a running cluster one with an ARM processor, until it ends."""
    emulated, programs = build_containerd(), obtain(print)
    directory = STATE / "clusters" / name / machine
    old = find_containerd(directory)
    # In the machine's own mount namespace: the other machines keep theirs.
    bind = ["mount", "--bind", str(emulated), programs.program("containerd")]
    run(["nsenter", "-t", old, "-m", *bind])
    run(["kill", old])
    until(lambda: find_containerd(directory) not in ("", old), "the emulated containerd")
    for _ in range(20):  # a kubelet whose containerd was away registers again, as amd64
        label(name, machine, kubectl)
        time.sleep(1)


def label(name: str, machine: str, kubectl: str) -> None:
    """Label a machine as one with an ARM processor; on a busy one the kubelet may do so later."""
    words = ["label", "node", machine, "kubernetes.io/arch=arm64", "--overwrite"]
    run([kubectl, f"--context=rigel-{name}", *words])


def find_containerd(directory: Path) -> str:
    """Return the process id of a machine's containerd."""
    command = f"containerd --config={directory / 'containerd.toml'}$"
    done = subprocess.run(["pgrep", "-f", command], capture_output=True, text=True, check=False)
    return done.stdout.split()[-1] if done.stdout else ""

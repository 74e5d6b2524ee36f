"""Machines of a local cluster that have ARM processors, as far as containers can see: emulated.

containerd decides which platform of an image a machine gets. Debian's for arm64 runs under QEMU,
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
from rigel_lab.cluster.components import obtain
from rigel_lab.cluster.paths import STATE

from .until import until

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


def fetch_containerd() -> Path:
    """Return a directory with Debian's containerd for arm64 and its libraries."""
    place = cache_dir() / "debian-arm64"
    with locked(place.with_suffix(".lock")):
        if not place.exists():
            work = place.with_name(".debian-arm64")
            shutil.rmtree(work, ignore_errors=True)
            command = ["mmdebstrap", "--architectures=arm64", "--variant=extract"]
            run([*command, "--include=containerd", "bookworm", str(work)])
            work.rename(place)
    return place


def change(name: str, machine: str, kubectl: str) -> None:
    """Make a machine of a running cluster one with an ARM processor, until it ends."""
    root, programs = fetch_containerd(), obtain(print)
    directory = STATE / "clusters" / name / machine
    start = directory / "containerd-arm64"
    # Pods' programs have libraries of their own; containerd has those beside it.
    start.write_text(
        f'#!/bin/sh\nexport QEMU_LD_PREFIX={root}\nexec {root}/usr/bin/containerd "$@"\n'
    )
    start.chmod(0o755)
    old = find_containerd(directory)
    # In the machine's own mount namespace: the other machines keep theirs.
    bind = ["mount", "--bind", str(start), programs.program("containerd")]
    run(["nsenter", "-t", old, "-m", *bind])
    run(["kill", old])
    until(lambda: find_containerd(directory) not in ("", old), "the emulated containerd")
    label = ["label", "node", machine, "kubernetes.io/arch=arm64", "--overwrite"]
    for _ in range(20):  # a kubelet whose containerd was away registers again, as amd64
        run([kubectl, f"--context=rigel-{name}", *label])
        time.sleep(1)


def find_containerd(directory: Path) -> str:
    """Return the process id of a machine's containerd."""
    command = f"containerd --config={directory / 'containerd.toml'}$"
    done = subprocess.run(["pgrep", "-f", command], capture_output=True, text=True, check=False)
    return done.stdout.split()[-1] if done.stdout else ""

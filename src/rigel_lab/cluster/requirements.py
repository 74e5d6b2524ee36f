"""What this machine must be and have; each refusal says what works instead."""

from __future__ import annotations

import os
import platform
import re
import shutil
from pathlib import Path

from rigel_k8s.errors import UserError
from rigel_lab.cluster.commands import run, search_path
from rigel_lab.cluster.paths import STATE

ELSEWHERE = "or use kind, minikube or k3s: rigel works with any cluster of your kubeconfig"

#: Each program that is used, and the Debian package that contains it.
PROGRAMS = {
    "hostname": "hostname",
    "ip": "iproute2",
    "iptables": "iptables",
    "nft": "nftables",
    "nsenter": "util-linux",
    "openssl": "openssl",
    "setsid": "util-linux",
    "unshare": "util-linux",
}


def check_name(name: str) -> None:
    """Refuse a name that cannot be part of a context, a cgroup or a path."""
    if not re.fullmatch(r"[a-z](-?[a-z0-9])*", name) or len(name) > 30:
        raise UserError(
            f'"{name}" is not a name for a local cluster',
            hint='at most 30 of a-z, 0-9 and "-", beginning with a letter',
        )


def require_root() -> None:
    """Refuse other systems than Linux, and other users than root."""
    if platform.system() != "Linux":
        raise UserError("the local cluster needs Linux", hint=ELSEWHERE.removeprefix("or "))
    if os.geteuid() != 0:
        raise UserError(
            "the local cluster needs root: it makes namespaces, a bridge and cgroups",
            hint=f"run it with sudo, {ELSEWHERE}",
        )


def require_host() -> None:
    """Refuse a machine on which a cluster cannot run."""
    require_root()
    path = search_path()
    missing = sorted({package for p, package in PROGRAMS.items() if not shutil.which(p, path=path)})
    if missing:
        raise UserError(
            f"the local cluster needs {', '.join(missing)}",
            hint=f"apt-get install {' '.join(missing)}",
        )
    require_disk(STATE)


def require_disk(path: Path) -> None:
    """Refuse a file system that cannot hold images: overlay on overlay does not work."""
    while not path.exists():
        path = path.parent
    kind = run(["stat", "--file-system", "--format=%T", str(path)]).strip()
    if kind in ("overlayfs", "aufs"):
        raise UserError(
            f"{path} is on {kind}, on which containers cannot lay images (is this a container?)",
            hint=f"mount a volume on {STATE}, {ELSEWHERE}",
        )

"""Where a kind of cluster keeps its CNI configuration and programs."""

from __future__ import annotations

import re
from typing import Literal

import attrs

Kind = Literal["k3s", "microk8s", "kind", "minikube", "plain"]

K3S_DATA_DIR = "/var/lib/rancher/k3s"
#: The first release of each k3s line whose CNI directory does not move in upgrades.
K3S_FIXED = {(1, 28): 15, (1, 29): 10, (1, 30): 6, (1, 31): 2}
#: MicroK8s' directories are behind a link that every refresh of the snap changes.
SNAP = "/var/snap/microk8s"


@attrs.frozen
class Platform:
    """Where the machines of one kind keep what CNI needs.

    Attributes:
        roots: directories that contain both, and all that links in them point to; pods mount them
            whole and at the same path, so links resolve even when their target changes.
        lacks_programs: whether its own set of CNI programs has no macvlan.
    """

    kind: Kind
    conf_dir: str
    bin_dir: str
    roots: tuple[str, ...]
    lacks_programs: bool = False


def platform(
    kind: Kind,
    *,
    version: str = "",
    data_dir: str | None = None,
    conf_dir: str | None = None,
    bin_dir: str | None = None,
) -> Platform:
    """Return a kind's directories.

    Args:
        version: the kubelet's, such as v1.31.2+k3s1; "" is a new one.
        data_dir: k3s' --data-dir; None: its default.
        conf_dir: if it is not the kind's own.
        bin_dir: if it is not the kind's own.
    """
    own_conf, own_bin, roots = OWN[kind](version, (data_dir or K3S_DATA_DIR).rstrip("/"))
    conf_dir, bin_dir = conf_dir or own_conf, bin_dir or own_bin
    return Platform(
        kind, conf_dir, bin_dir, _choose_mounts(roots, (conf_dir, bin_dir)), kind in ("k3s", "kind")
    )


def _k3s(version: str, data_dir: str) -> tuple[str, str, tuple[str, ...]]:
    programs = "data/cni" if _is_fixed(version) else "data/current/bin"
    # The programs are links into data/HASH; after an upgrade, k3s uses another HASH.
    return (
        f"{data_dir}/agent/etc/cni/net.d",
        f"{data_dir}/{programs}",
        (f"{data_dir}/data",),
    )


def _microk8s(_version: str, _data_dir: str) -> tuple[str, str, tuple[str, ...]]:
    return f"{SNAP}/current/args/cni-network", f"{SNAP}/current/opt/cni/bin", (SNAP,)


def _plain(_version: str, _data_dir: str) -> tuple[str, str, tuple[str, ...]]:
    return "/etc/cni/net.d", "/opt/cni/bin", ()


OWN = {"k3s": _k3s, "microk8s": _microk8s, "kind": _plain, "minikube": _plain, "plain": _plain}


def _is_fixed(version: str) -> bool:
    """Return whether this k3s has `data/cni`."""
    found = re.match(r"v?(\d+)\.(\d+)\.(\d+)", version)
    if not found:
        return True
    major, minor, patch = map(int, found.groups())
    if (major, minor) in K3S_FIXED:
        return patch >= K3S_FIXED[major, minor]
    return (major, minor) > max(K3S_FIXED)


def _choose_mounts(roots: tuple[str, ...], directories: tuple[str, ...]) -> tuple[str, ...]:
    """Return the roots that are needed, and the directories that lie in none of them."""
    used = [root for root in roots if any(_is_within(d, root) for d in directories)]
    rest = [d for d in directories if not any(_is_within(d, root) for root in used)]
    return tuple(dict.fromkeys([*used, *rest]))


def _is_within(directory: str, root: str) -> bool:
    return directory == root or directory.startswith(f"{root}/")

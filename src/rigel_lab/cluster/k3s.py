"""A node's programs and labels as k3s has them, written after reading k3s (not available here).

k3s keeps one program `cni` with many names in a directory whose name is a new hash for each
release, and links to it, absolute, in a directory that stays. Files of others stay there too.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

from rigel_lab.cluster.layout import K3S_DATA

#: Where a server has the administrator's kubeconfig.
KUBECONFIG = "/etc/rancher/k3s/k3s.yaml"

#: The CNI programs of k3s; `ptp`, which connects the cluster's pods, takes the place of `flannel`.
PROGRAMS = ("bandwidth", "bridge", "firewall", "host-local", "loopback", "portmap", "ptp")

#: The one program: it acts by the name under which it is called.
MULTICALL = """#!/bin/sh
exec "$(dirname "$(readlink -f "$0")")/aux/${0##*/}" "$@"
"""


def release_name(release: str) -> str:
    """Return the name of a release's directory; k3s takes the hash of what is in it."""
    return hashlib.sha256(f"k3s {release}".encode()).hexdigest()


def unpack(own: Path, data_dir: str, programs: Path, release: str) -> str:
    """Unpack a release as k3s does when it starts, and make it the current one.

    A later release is an upgrade: its links replace the old ones, the old directory stays as
    `previous`, and files of others stay too. The same release again changes nothing.

    Args:
        own: where the machine has the node's data directory.
        data_dir: the path of the same directory inside the node.
        programs: a directory with the CNI programs.
        release: the release's name.

    Returns:
        The name of its directory.
    """
    name = release_name(release)
    home = own / "data" / name
    if home.exists():
        return name
    extract(home, programs)
    inside = Path(data_dir, "data", name)
    stable = own / "data/cni"
    stable.mkdir(exist_ok=True)
    (stable / "cni").unlink(missing_ok=True)
    for program in ("cni", *PROGRAMS):
        link(stable / program, inside / "bin/cni")
    rotate(own / "data", inside)
    return name


def extract(home: Path, programs: Path) -> None:
    """Lay down the one program and its names."""
    auxiliary = home / "bin/aux"
    auxiliary.mkdir(parents=True)
    for program in PROGRAMS:
        shutil.copy2(programs / program, auxiliary / program)
        (home / "bin" / program).symlink_to("cni")
    multicall = home / "bin/cni"
    multicall.write_text(MULTICALL)
    multicall.chmod(0o755)


def link(path: Path, target: Path) -> None:
    """Link to a release's program; another program's file of that name stays."""
    if path.is_symlink():
        path.unlink()
    if not path.exists():
        path.symlink_to(target)


def rotate(data: Path, inside: Path) -> None:
    """Link `current` to a release, and `previous` to the one before."""
    current = data / "current"
    if current.is_symlink():
        current.replace(data / "previous")
    current.symlink_to(inside)


def node_labels(*, server: bool) -> dict[str, str]:
    """Return k3s' labels of a node; a server's node runs pods like any other."""
    labels = {"node.kubernetes.io/instance-type": "k3s", "beta.kubernetes.io/instance-type": "k3s"}
    return labels | ({"node-role.kubernetes.io/control-plane": "true"} if server else {})


def node_annotations(data_dir: str, release: str, *, server: bool) -> dict[str, str]:
    """Return k3s' annotations of a node: its arguments and variables.

    Args:
        data_dir: the data directory; the default one needs no argument.
        release: what is unpacked there.
        server: whether the node is the server, else an agent.
    """
    given = [] if data_dir == K3S_DATA else ["--data-dir", data_dir]
    variables = {"K3S_DATA_DIR": f"{data_dir}/data/{release_name(release)}"}
    arguments = ["server" if server else "agent", *given]
    return {
        "k3s.io/node-args": json.dumps(arguments, separators=(",", ":")),
        "k3s.io/node-env": json.dumps(variables, separators=(",", ":")),
    }

"""Where machines keep CNI configuration and programs, which their nodes show; pure."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import attrs

from rigel_k8s.network.options import Install
from rigel_k8s.objects.overlay import parse_json

Node = Mapping[str, Any]
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
    """

    kind: Kind
    conf_dir: str
    bin_dir: str
    roots: tuple[str, ...]

    @property
    def lacks_programs(self) -> bool:
        """Whether its own set of CNI programs has no macvlan."""
        return self.kind in ("k3s", "kind")


@attrs.frozen
class Group:
    """The machines that keep CNI's files in the same places."""

    platform: Platform
    nodes: tuple[str, ...] = ()

    @property
    def suffix(self) -> str:
        """The suffix of its objects' names beside those of another group, whatever its machines."""
        where = f"{self.platform.conf_dir} {self.platform.bin_dir}"
        return f"-{self.platform.kind}-{hashlib.sha256(where.encode()).hexdigest()[:6]}"


def group_by_platform(nodes: Iterable[Node], install: Install) -> tuple[Group, ...]:
    """Return the cluster's Linux machines by platform, the largest group first.

    A cluster may have several: a k3s server on a laptop and a robot with another --data-dir.
    What `install` sets applies to all of them.
    """
    names: dict[Platform, list[str]] = {}
    for node in nodes:
        if labels_of(node).get("kubernetes.io/os", "linux") == "linux":
            names.setdefault(platform_of(node, install), []).append(node["metadata"]["name"])
    groups = [Group(where, tuple(sorted(some))) for where, some in names.items()]
    return tuple(sorted(groups, key=lambda group: (-len(group.nodes), group.nodes)))


def platform_of(node: Node, install: Install) -> Platform:
    """Return where a machine keeps CNI's files."""
    return platform(
        install.platform or kind_of(node),
        version=version_of(node),
        data_dir=install.data_dir or find_data_dir(node),
        conf_dir=install.cni_conf_dir,
        bin_dir=install.cni_bin_dir,
    )


def kind_of(node: Node) -> Kind:
    """Return the kind of cluster that a machine belongs to."""
    labels = labels_of(node)
    if "+k3s" in version_of(node):
        return "k3s"
    if "microk8s.io/cluster" in labels:
        return "microk8s"
    if node.get("spec", {}).get("providerID", "").startswith("kind://"):
        return "kind"
    return "minikube" if "minikube.k8s.io/name" in labels else "plain"


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
        version: the kubelet's, such as v1.31.2+k3s1; without +k3s it is a new one.
        data_dir: k3s' --data-dir; None: its default.
        conf_dir: if it is not the kind's own.
        bin_dir: if it is not the kind's own.
    """
    conf, programs, root = "/etc/cni/net.d", "/opt/cni/bin", ""
    if kind == "k3s":
        where = (data_dir or K3S_DATA_DIR).rstrip("/")
        conf = f"{where}/agent/etc/cni/net.d"
        # The programs are links into data/HASH; after an upgrade, k3s uses another HASH.
        programs = f"{where}/data/cni" if is_fixed(version) else f"{where}/data/current/bin"
        root = f"{where}/data"
    elif kind == "microk8s":
        conf, programs = f"{SNAP}/current/args/cni-network", f"{SNAP}/current/opt/cni/bin"
        root = SNAP
    conf, programs = conf_dir or conf, bin_dir or programs
    outside = [one for one in (conf, programs) if not root or not is_within(one, root)]
    roots = [root, *outside] if len(outside) < 2 else outside
    return Platform(kind, conf, programs, tuple(dict.fromkeys(roots)))


def is_fixed(version: str) -> bool:
    """Return whether the CNI programs of this k3s are in `data/cni`."""
    numbers = re.match(r"v?(\d+)\.(\d+)\.(\d+)\+k3s", version)
    if not numbers:
        return True
    major, minor, patch = map(int, numbers.groups())
    if (major, minor) in K3S_FIXED:
        return patch >= K3S_FIXED[major, minor]
    return (major, minor) > max(K3S_FIXED)


def is_within(directory: str, root: str) -> bool:
    """Return whether a directory is another one or lies in it."""
    return f"{directory}/".startswith(f"{root}/")


def find_data_dir(node: Node) -> str | None:
    """Return the --data-dir that k3s was started with; k3s writes it into an annotation."""
    annotations = node["metadata"].get("annotations") or {}
    words: list[Any] = parse_json(annotations.get("k3s.io/node-args"), [])
    if given := read_data_dir([str(word) for word in words]):
        return given
    environment: dict[str, Any] = parse_json(annotations.get("k3s.io/node-env"), {})
    given = str(environment.get("K3S_DATA_DIR", ""))
    # k3s also uses this variable to pass its processes the directory of its unpacked programs.
    return re.sub(r"/data/[0-9a-f]{32,}/?$", "", given) or None


def read_data_dir(words: Sequence[str]) -> str | None:
    """Return the value of --data-dir in a command line."""
    for place, word in enumerate(words):
        name, _, value = word.partition("=")
        if name in ("--data-dir", "-d"):
            return value or (words[place + 1] if place + 1 < len(words) else None)
    return None


def labels_of(node: Node) -> Mapping[str, str]:
    labels: Mapping[str, str] = node["metadata"].get("labels") or {}
    return labels


def version_of(node: Node) -> str:
    """Return the version of a node's kubelet."""
    return str(node.get("status", {}).get("nodeInfo", {}).get("kubeletVersion", ""))

"""Where a node has what other programs look for: plain Kubernetes' places, or those of k3s.

It handles paths only, independent of what is put there.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import attrs

#: k3s' default data directory.
K3S_DATA = "/var/lib/rancher/k3s"

#: Paths of every node -> the directory of the node that is bound over each.
BOUND = {
    "/etc/cni": "etc-cni",
    "/opt/cni": "opt-cni",
    "/opt/local-path-provisioner": "local-path",
    "/var/lib/kubelet": "kubelet",
    "/var/lib/containerd": "containerd",
    "/var/lib/cni": "cni",
    # Lines that wait: another cluster would send them to its own Loki.
    "/var/lib/rigel-otel-collector": "otel-collector",
    "/var/lib/rigel-promtail": "promtail",
    "/var/log/pods": "pod-logs",
    "/var/log/containers": "container-logs",
}


@attrs.frozen
class NodePaths:
    """Where a node has what other programs look for, as paths inside it.

    Attributes:
        cni_config: the directory of CNI configurations.
        cni_programs: the directory of CNI programs.
        containerd: the directory of containerd's data.
        socket: containerd's socket.
        binds: path inside -> the directory of the node that is bound over it.
        data_dir: k3s' data directory, None on a plain node.
    """

    cni_config: str
    cni_programs: str
    containerd: str
    socket: str
    binds: Mapping[str, str]
    data_dir: str | None = None

    def locate(self, directory: Path, inside: str) -> Path:
        """Return the machine's path of a path inside a node.

        Args:
            directory: the node's directory.
            inside: a path below one that is bound over.
        """
        for target, name in self.binds.items():
            if PurePosixPath(inside).is_relative_to(target):
                return directory / name / PurePosixPath(inside).relative_to(target)
        raise ValueError(f"{inside} is not the node's own")


def plain_paths() -> NodePaths:
    return NodePaths(
        cni_config="/etc/cni/net.d",
        cni_programs="/opt/cni/bin",
        containerd="/var/lib/containerd",
        socket="/run/containerd/containerd.sock",
        binds=BOUND,
    )


def k3s_paths(data_dir: str) -> NodePaths:
    """Return the places of a node of k3s; its /etc/cni and /opt/cni exist and are empty."""
    return NodePaths(
        cni_config=f"{data_dir}/agent/etc/cni/net.d",
        cni_programs=f"{data_dir}/data/cni",
        containerd=f"{data_dir}/agent/containerd",
        socket="/run/k3s/containerd/containerd.sock",
        binds={data_dir: "k3s", "/etc/rancher": "etc-rancher", **BOUND},
        data_dir=data_dir,
    )

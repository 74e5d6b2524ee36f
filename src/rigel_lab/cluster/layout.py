"""Everything that the machines of one cluster share: names, addresses, keys, programs, paths."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import attrs

from rigel_lab.cluster import kubeconfig
from rigel_lab.cluster.addresses import Addresses
from rigel_lab.cluster.certificates import Authority
from rigel_lab.cluster.components import Components

API_PORT = 6443
REGISTRY_PORT = 5000
CONTROL_PLANE = "control-plane"
#: The node that acts as the server if nodes are like k3s'.
SERVER = "node1"

#: Each machine's number is the last part of its address.
CONTROL_PLANE_NUMBER = 2
FIRST_NODE_NUMBER = 11
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


def number(machine: str) -> int:
    """Return a machine's number on the segment: node1 is 11."""
    if machine == CONTROL_PLANE:
        return CONTROL_PLANE_NUMBER
    return FIRST_NODE_NUMBER - 1 + int(machine.removeprefix("node"))


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


@attrs.frozen
class Layout:
    """Everything that the machines of one cluster share."""

    name: str
    directory: Path
    addresses: Addresses
    components: Components
    nodes: NodePaths = attrs.field(factory=plain_paths)

    @property
    def pki(self) -> Path:
        """The directory of keys and certificates."""
        return self.directory / "pki"

    @property
    def control_plane(self) -> str:
        """The control plane's address."""
        return self.addresses.machine(CONTROL_PLANE_NUMBER)

    @property
    def server(self) -> str:
        """The API server's URL."""
        return f"https://{self.control_plane}:{API_PORT}"

    @property
    def registry(self) -> str:
        """The image registry, HOST:PORT."""
        return f"{self.control_plane}:{REGISTRY_PORT}"

    def namespace(self, machine: str) -> str:
        return f"rigel-{self.name}-{machine}"

    def address(self, machine: str) -> str:
        """Return a machine's address on the segment."""
        return self.addresses.machine(number(machine))

    def authority(self) -> Authority:
        """The cluster's certificate authority."""
        return Authority(self.pki)

    def kubeconfig(self, user: str, common_name: str, organization: str | None = None) -> Path:
        """Write (once) and return the kubeconfig of a component."""
        path = self.directory / "kubeconfigs" / f"{user}.yaml"
        if not path.exists():
            ca = self.authority()
            certificate, key = ca.issue(user, common_name, organization=organization)
            path.parent.mkdir(mode=0o700, exist_ok=True)
            content = kubeconfig.entries(user, self.server, ca.certificate, certificate, key)
            path.write_text(json.dumps(content))
        return path

    def program(self, name: str) -> str:
        return self.components.program(name)

    def environment(self, given: Mapping[str, str] = os.environ) -> dict[str, str]:
        """Return the variables of machines: none of the user's except those for the Internet.

        The cluster's own addresses are reached without a proxy.
        """
        path = [*self.components.path, "/usr/sbin", "/usr/bin", "/sbin", "/bin"]
        result = {"PATH": ":".join(path), "HOME": "/root", "LANG": "C.UTF-8"}
        kept = ("SSL_CERT_FILE", "SSL_CERT_DIR", "HTTP_PROXY", "HTTPS_PROXY")
        result |= {k: v for k, v in given.items() if k.upper() in kept}
        if any(key.upper().endswith("_PROXY") for key in result):
            direct = ["localhost", "127.0.0.1", self.addresses.block, ".svc", ".cluster.local"]
            outside = given.get("NO_PROXY") or given.get("no_proxy")
            result["NO_PROXY"] = ",".join([*direct, *filter(None, [outside])])
        return result

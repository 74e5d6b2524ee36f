"""What a node of k3s has apart from its paths: its programs, its kubeconfig, its server's port.

The first node acts as the server: what is sent to its port of the API reaches the control plane, so
that a laptop finds a cluster where it would find a robot's.
"""

from __future__ import annotations

from pathlib import Path

from rigel_k8s.yaml_text import document
from rigel_lab.cluster import api, k3s
from rigel_lab.cluster.components import KUBERNETES_VERSION
from rigel_lab.cluster.layout import API_PORT, SERVER, Layout


def furnish(layout: Layout, directory: Path, data_dir: str) -> None:
    """Unpack k3s' programs on a node; the server has /etc/rancher/k3s/k3s.yaml as well."""
    own = layout.nodes.locate(directory, data_dir)
    k3s.unpack(own, data_dir, layout.components.cni_plugins, KUBERNETES_VERSION)
    if directory.name != SERVER:
        return
    path = layout.nodes.locate(directory, k3s.KUBECONFIG)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch(mode=0o600)
    content = api.access(layout, "default", f"https://127.0.0.1:{API_PORT}")
    path.write_text(document(content))


def setup(layout: Layout, name: str) -> list[str]:
    """Return the shell lines that forward the server's port to the control plane."""
    if not layout.nodes.data_dir or name != SERVER:
        return []
    own = f"-p tcp --dport {API_PORT}"
    answer = f"-m conntrack --ctstate DNAT --ctorigdst {layout.address(name)}"
    return [
        f"iptables -w -t nat -A PREROUTING -d {layout.address(name)} {own}"
        f" -j DNAT --to-destination {layout.control_plane}:{API_PORT}",
        f"iptables -w -t nat -A POSTROUTING {own} {answer} -j MASQUERADE",
    ]

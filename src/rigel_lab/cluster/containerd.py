"""containerd's configuration, and from where it takes images.

Every registry is looked up here first: an image that was pushed as REGISTRY/library/ros is what
pods name `ros`. What the local registry does not have comes from the registry in the image's name.
"""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath

from rigel_lab.cluster.layout import Layout

CAP_SYS_RESOURCE = 24


def configure_containerd(layout: Layout, directory: Path) -> None:
    """Write a node's containerd.toml and certs.d."""
    certs, nodes = directory / "certs.d", layout.nodes
    mirror = f'[host."http://{layout.registry}"]\n  capabilities = ["pull", "resolve"]\n'
    own = f'server = "http://{layout.registry}"\n{mirror}'
    for registry, text in {layout.registry: own, "_default": mirror}.items():
        (certs / registry).mkdir(parents=True, exist_ok=True)
        (certs / registry / "hosts.toml").write_text(text)
    (directory / "containerd.toml").write_text(
        f"""version = 2
root = "{nodes.containerd}"
state = "{PurePosixPath(nodes.socket).parent}"
[grpc]
  address = "{nodes.socket}"
[plugins."io.containerd.internal.v1.opt"]
  path = "{nodes.containerd}/opt"
[plugins."io.containerd.grpc.v1.cri"]
  sandbox_image = "{layout.registry}/rigel-k8s/pause:1"
  restrict_oom_score_adj = {json.dumps(not may_raise_limits())}
  [plugins."io.containerd.grpc.v1.cri".cni]
    bin_dir = "{nodes.cni_programs}"
    conf_dir = "{nodes.cni_config}"
  [plugins."io.containerd.grpc.v1.cri".registry]
    config_path = "{certs}"
  [plugins."io.containerd.grpc.v1.cri".containerd.runtimes.runc]
    runtime_type = "io.containerd.runc.v2"
"""
    )


def may_raise_limits() -> bool:
    """Return whether we have CAP_SYS_RESOURCE, which protecting sandboxes from OOM needs."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> CAP_SYS_RESOURCE & 1)
    return False

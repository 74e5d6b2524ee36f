"""A node's machine: containerd, kubelet and kube-proxy, each on its default paths or those of k3s.

The first node of k3s acts as the server: what is sent to its port of the API reaches the control
plane, so that a laptop finds a cluster where it would find a robot's.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path, PurePosixPath

from rigel_k8s.yaml_text import document
from rigel_lab.cluster import (
    api,
    k3s,
)
from rigel_lab.cluster.components import KUBERNETES_VERSION
from rigel_lab.cluster.layout import API_PORT, SERVER, Layout
from rigel_lab.cluster.machine import Machine

CAP_SYS_RESOURCE = 24


def node(layout: Layout, name: str, *, cgroup: str, mtu: int) -> Machine:
    """Return the machine of one node.

    Args:
        layout: what the machines of the cluster share.
        name: its name.
        cgroup: the node's cgroup from the root; pods go below it.
        mtu: of the pods' interfaces.
    """
    directory = layout.directory / name
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    configure_containerd(layout, directory)
    configure_kubelet(layout, directory, cgroup)
    configure_cni(layout, directory, mtu)
    install_cni(layout, directory)
    return Machine(
        name=name,
        namespace=layout.namespace(name),
        directory=directory,
        environment=layout.environment(),
        init=layout.program("catatonit"),
        binds={directory / own: path for path, own in layout.nodes.binds.items()},
        setup=setup(layout, directory),
        services={
            "containerd": [
                layout.program("containerd"),
                f"--config={directory / 'containerd.toml'}",
            ],
            "kubelet": kubelet(layout, name, directory),
            "kube-proxy": kube_proxy(layout, name),
        },
    )


def setup(layout: Layout, directory: Path) -> list[str]:
    """Return the shell lines before the services: forwarding, a way out, name servers.

    Pods are hidden behind their node for what leaves the cluster, and only for that. If the
    machine's resolv.conf was in /run, it does not exist now; else it is covered.
    """
    block = layout.addresses.block
    rule = f"POSTROUTING -s {block} ! -d {block} -j MASQUERADE"
    return [
        "echo 1 >/proc/sys/net/ipv4/ip_forward",
        f"iptables -w -t nat -A {rule}",
        "target=$(readlink -m /etc/resolv.conf)",
        'case "$target" in /run/*) mkdir -p "${target%/*}"; : >"$target";; esac',
        f'[ ! -e "$target" ] || mount --bind "{directory}/resolv.conf" "$target"',
        *forward_api(layout, directory.name),
    ]


def forward_api(layout: Layout, name: str) -> list[str]:
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


def kubelet(layout: Layout, name: str, directory: Path) -> list[str]:
    """Return the kubelet's command line."""
    return [
        layout.program("kubelet"),
        f"--config={directory / 'kubelet.yaml'}",
        f"--kubeconfig={layout.kubeconfig(name, f'system:node:{name}', 'system:nodes')}",
        f"--hostname-override={name}",
        f"--node-ip={layout.address(name)}",
    ]


def kube_proxy(layout: Layout, name: str) -> list[str]:
    """Return kube-proxy's command line; conntrack's limits belong to the whole machine."""
    return [
        layout.program("kube-proxy"),
        f"--kubeconfig={layout.kubeconfig('kube-proxy', 'system:kube-proxy')}",
        f"--hostname-override={name}",
        "--proxy-mode=iptables",
        f"--cluster-cidr={layout.addresses.pods}",
        "--conntrack-max-per-core=0",
        "--conntrack-min=0",
        "--conntrack-tcp-timeout-established=0s",
        "--conntrack-tcp-timeout-close-wait=0s",
    ]


def configure_containerd(layout: Layout, directory: Path) -> None:
    """Write containerd's configuration, and from where it takes images.

    Every registry is looked up here first: an image that was pushed as REGISTRY/library/ros is what
    pods name `ros`. What the local registry does not have comes from that in the image's name.
    """
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


def configure_kubelet(layout: Layout, directory: Path, cgroup: str) -> None:
    """Write the kubelet's configuration."""
    write_resolv_conf(directory)
    config = {
        "apiVersion": "kubelet.config.k8s.io/v1beta1",
        "kind": "KubeletConfiguration",
        "authentication": {
            "anonymous": {"enabled": False},
            "webhook": {"enabled": True},
            "x509": {"clientCAFile": str(layout.authority().certificate)},
        },
        "authorization": {"mode": "Webhook"},
        "clusterDNS": [layout.addresses.dns_service],
        "clusterDomain": "cluster.local",
        "containerRuntimeEndpoint": f"unix://{layout.nodes.socket}",
        "cgroupDriver": "cgroupfs",
        "cgroupRoot": cgroup,
        "cgroupsPerQOS": True,
        "enforceNodeAllocatable": ["pods"],
        "failSwapOn": False,
        "failCgroupV1": False,
        "maxPods": 200,
        "serializeImagePulls": False,
        "resolvConf": str(directory / "resolv.conf"),
        "volumePluginDir": "/var/lib/kubelet/volume-plugins",
        # The disk belongs to the machine: a full one must not evict pods or collect images here.
        "imageGCHighThresholdPercent": 100,
        "evictionHard": {
            "nodefs.available": "0%",
            "nodefs.inodesFree": "0%",
            "imagefs.available": "0%",
        },
    }
    (directory / "kubelet.yaml").write_text(json.dumps(config))


def write_resolv_conf(directory: Path) -> None:
    """Write the machine's name servers for a node and its pods, into the file that they have."""
    (directory / "resolv.conf").write_text(resolv_conf())


def resolv_conf(
    files: tuple[Path, ...] = (Path("/run/systemd/resolve/resolv.conf"), Path("/etc/resolv.conf")),
) -> str:
    """Return the name servers, without those on loopback, which a node cannot reach."""
    for path in filter(Path.exists, files):
        words = [line.split() for line in path.read_text().splitlines()]
        servers = [w[1] for w in words if w[:1] == ["nameserver"] and len(w) > 1]
        if reachable := [s for s in servers if not s.startswith("127.") and s != "::1"]:
            return "".join(f"nameserver {server}\n" for server in reachable)
    return ""


def configure_cni(layout: Layout, directory: Path, mtu: int) -> None:
    # ptp, not bridge: Services on the same node need no br_netfilter, and pods receive no multicast
    # of each other, as on most real clusters.
    link = {
        "type": "ptp",
        "ipMasq": False,
        "mtu": mtu,
        "ipam": {
            "type": "host-local",
            "ranges": [[{"subnet": layout.addresses.pod_range(directory.name)}]],
            "routes": [{"dst": "0.0.0.0/0"}],
        },
    }
    ports = {"type": "portmap", "capabilities": {"portMappings": True}}
    config = {"cniVersion": "0.4.0", "name": "rigel", "plugins": [link, ports]}
    place = layout.nodes.locate(directory, layout.nodes.cni_config)
    place.mkdir(parents=True, exist_ok=True)
    (place / "10-rigel.conflist").write_text(json.dumps(config))


def install_cni(layout: Layout, directory: Path) -> None:
    """Put the standard CNI programs in place; a node of k3s has those of k3s alone."""
    if data_dir := layout.nodes.data_dir:
        furnish_k3s(layout, directory, data_dir)
        return
    place = layout.nodes.locate(directory, layout.nodes.cni_programs)
    if not place.exists():
        shutil.copytree(layout.components.cni_plugins, place)


def furnish_k3s(layout: Layout, directory: Path, data_dir: str) -> None:
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

"""The two kinds of machine of a local cluster: the control plane and a node."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.localcluster.addresses import Addresses
from rigel_k8s.localcluster.certificates import Authority, service_account_key
from rigel_k8s.localcluster.components import Components
from rigel_k8s.localcluster.host import netns_name
from rigel_k8s.localcluster.machine import Machine

__all__ = ["API_PORT", "REGISTRY_PORT", "Layout", "control_plane", "node"]

API_PORT = 6443
REGISTRY_PORT = 5000
CONTROL_PLANE = 2
FIRST_NODE = 11


@attrs.frozen
class Layout:
    """Everything that the machines of one cluster share."""

    name: str
    directory: Path
    addresses: Addresses
    components: Components

    @property
    def pki(self) -> Path:
        """The directory of keys and certificates."""
        return self.directory / "pki"

    @property
    def server(self) -> str:
        """The API server's URL."""
        return f"https://{self.addresses.machine(CONTROL_PLANE)}:{API_PORT}"

    @property
    def registry(self) -> str:
        """The image registry, HOST:PORT."""
        return f"{self.addresses.machine(CONTROL_PLANE)}:{REGISTRY_PORT}"

    def authority(self) -> Authority:
        """The cluster's certificate authority."""
        return Authority(self.pki)

    def kubeconfig(self, user: str, common_name: str, organization: str | None = None) -> Path:
        """Write (once) and return the kubeconfig of a component or an administrator."""
        path = self.directory / "kubeconfigs" / f"{user}.yaml"
        if not path.exists():
            ca = self.authority()
            certificate, key = ca.issue(user, common_name, organization=organization)
            path.parent.mkdir(exist_ok=True)
            path.touch(mode=0o600)
            content = kubeconfig(self.server, ca.certificate, certificate, key)
            path.write_text(json.dumps(content))
        return path

    def program(self, name: str) -> str:
        """Return the path of a program."""
        return str(self.components.program(name))


def kubeconfig(server: str, ca: Path, certificate: Path, key: Path) -> dict[str, Any]:
    """Return a kubeconfig (JSON is YAML) that names its files."""
    user = {"client-certificate": str(certificate), "client-key": str(key)}
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [
            {"name": "c", "cluster": {"server": server, "certificate-authority": str(ca)}}
        ],
        "users": [{"name": "u", "user": user}],
        "contexts": [{"name": "x", "context": {"cluster": "c", "user": "u"}}],
        "current-context": "x",
    }


def control_plane(layout: Layout) -> Machine:
    """Return the machine of etcd, the API server, its controllers, and the registry."""
    directory = layout.directory / "control-plane"
    return Machine(
        name="control-plane",
        namespace=netns_name(layout.name, "control-plane"),
        directory=directory,
        init=layout.components.program("catatonit"),
        services={
            "etcd": etcd(layout, directory),
            "kube-apiserver": apiserver(layout),
            "kube-controller-manager": controller_manager(layout),
            "kube-scheduler": scheduler(layout),
            "registry": registry(layout, directory),
        },
    )


def etcd(layout: Layout, directory: Path) -> list[str]:
    """Return etcd's command line: on loopback of its own namespace, where nobody else is."""
    return [
        layout.program("etcd"),
        f"--data-dir={directory / 'etcd'}",
        "--listen-client-urls=http://127.0.0.1:2379",
        "--advertise-client-urls=http://127.0.0.1:2379",
        "--listen-peer-urls=http://127.0.0.1:2380",
        "--initial-advertise-peer-urls=http://127.0.0.1:2380",
        "--initial-cluster=default=http://127.0.0.1:2380",
        "--unsafe-no-fsync",  # a throw-away cluster; it is rebuilt after a crash of the machine
        "--auto-compaction-retention=1",
    ]


def apiserver(layout: Layout) -> list[str]:
    """Return the API server's command line."""
    ca, addresses = layout.authority(), layout.addresses
    address = addresses.machine(CONTROL_PLANE)
    names = ["kubernetes", "kubernetes.default", "kubernetes.default.svc"]
    names += ["kubernetes.default.svc.cluster.local", "localhost"]
    alternatives = [f"DNS:{n}" for n in names]
    alternatives += [f"IP:{ip}" for ip in (address, addresses.api_service, "127.0.0.1")]
    certificate, key = ca.issue("apiserver", "kube-apiserver", alternatives=alternatives)
    client, client_key = ca.issue("kubelet-client", "kube-apiserver", organization="system:masters")
    front = Authority(layout.pki, "front-proxy-ca")
    proxy, proxy_key = front.issue("front-proxy-client", "front-proxy-client")
    private, public = service_account_key(layout.pki)
    return [
        layout.program("kube-apiserver"),
        "--etcd-servers=http://127.0.0.1:2379",
        f"--bind-address={address}",
        f"--advertise-address={address}",
        f"--secure-port={API_PORT}",
        f"--service-cluster-ip-range={addresses.services}",
        "--authorization-mode=Node,RBAC",
        "--enable-admission-plugins=NodeRestriction",
        "--allow-privileged=true",
        f"--client-ca-file={ca.certificate}",
        f"--tls-cert-file={certificate}",
        f"--tls-private-key-file={key}",
        f"--kubelet-client-certificate={client}",
        f"--kubelet-client-key={client_key}",
        "--kubelet-preferred-address-types=InternalIP",
        "--service-account-issuer=https://kubernetes.default.svc.cluster.local",
        f"--service-account-key-file={public}",
        f"--service-account-signing-key-file={private}",
        f"--requestheader-client-ca-file={front.certificate}",
        "--requestheader-allowed-names=front-proxy-client",
        "--requestheader-username-headers=X-Remote-User",
        "--requestheader-group-headers=X-Remote-Group",
        "--requestheader-extra-headers-prefix=X-Remote-Extra-",
        f"--proxy-client-cert-file={proxy}",
        f"--proxy-client-key-file={proxy_key}",
        "--enable-aggregator-routing=true",
    ]


def controller_manager(layout: Layout) -> list[str]:
    """Return the controller manager's command line."""
    user = "system:kube-controller-manager"
    config = layout.kubeconfig("kube-controller-manager", user)
    ca = layout.authority().certificate
    return [
        layout.program("kube-controller-manager"),
        f"--kubeconfig={config}",
        "--bind-address=127.0.0.1",
        "--use-service-account-credentials=true",
        f"--service-account-private-key-file={service_account_key(layout.pki)[0]}",
        f"--root-ca-file={ca}",
        f"--cluster-signing-cert-file={ca}",
        f"--cluster-signing-key-file={layout.pki / 'ca.key'}",
        f"--cluster-cidr={layout.addresses.pods}",
        f"--service-cluster-ip-range={layout.addresses.services}",
        "--leader-elect=false",
    ]


def scheduler(layout: Layout) -> list[str]:
    """Return the scheduler's command line."""
    config = layout.kubeconfig("kube-scheduler", "system:kube-scheduler")
    return [
        layout.program("kube-scheduler"),
        f"--kubeconfig={config}",
        "--bind-address=127.0.0.1",
        "--leader-elect=false",
    ]


def registry(layout: Layout, directory: Path) -> list[str]:
    """Write the registry's configuration and return its command line."""
    config = {
        "version": 0.1,
        "log": {"level": "warn"},
        "storage": {
            "filesystem": {"rootdirectory": str(directory / "registry")},
            "delete": {"enabled": True},
        },
        "http": {"addr": layout.registry},
    }
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / "registry.yml"
    path.write_text(json.dumps(config))
    return [layout.program("docker-registry"), "serve", str(path)]


def node(layout: Layout, index: int, *, cgroup: str, limits: bool) -> Machine:
    """Return the machine of one node, counted from 1.

    Args:
        layout: what the machines of the cluster share.
        index: which node.
        cgroup: the node's cgroup from the root; pods go below it.
        limits: whether this machine may raise limits (CAP_SYS_RESOURCE).
    """
    name = f"node{index}"
    directory = layout.directory / name
    configure_containerd(layout, directory, limits=limits)
    configure_kubelet(layout, directory, cgroup)
    configure_cni(layout, directory, index)
    address = layout.addresses.machine(FIRST_NODE - 1 + index)
    return Machine(
        name=name,
        namespace=netns_name(layout.name, name),
        directory=directory,
        init=layout.components.program("catatonit"),
        path=[
            str(layout.components.prefix / "usr/bin"),
            str(layout.components.prefix / "usr/sbin"),
        ],
        binds={
            str(directory / "etc-cni"): "/etc/cni",
            str(directory / "opt-cni"): "/opt/cni",
            str(directory / "local-path"): "/opt/local-path-provisioner",
            str(directory / "kubelet"): "/var/lib/kubelet",
            str(directory / "containerd"): "/var/lib/containerd",
            str(directory / "cni"): "/var/lib/cni",
            str(directory / "pod-logs"): "/var/log/pods",
            str(directory / "container-logs"): "/var/log/containers",
        },
        setup=[
            "echo 1 > /proc/sys/net/ipv4/ip_forward",
            f"iptables -t nat -C POSTROUTING {masquerade(layout)} 2>/dev/null ||"
            f" iptables -t nat -A POSTROUTING {masquerade(layout)}",
        ],
        services={
            "containerd": [
                layout.program("containerd"),
                "--config",
                str(directory / "containerd.toml"),
            ],
            "kubelet": [
                layout.program("kubelet"),
                f"--config={directory / 'kubelet.yaml'}",
                f"--kubeconfig={layout.kubeconfig(name, f'system:node:{name}', 'system:nodes')}",
                f"--hostname-override={name}",
                f"--node-ip={address}",
            ],
            "kube-proxy": kube_proxy(layout, name),
        },
    )


def masquerade(layout: Layout) -> str:
    """Return the rule that hides pods behind their node, for what leaves the cluster."""
    block = layout.addresses.block
    return f"-s {block} ! -d {block} -j MASQUERADE"


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


def configure_containerd(layout: Layout, directory: Path, *, limits: bool) -> None:
    """Write containerd's configuration and where it looks for images."""
    certs = directory / "certs.d"
    # Every registry is tried here first, so an image pushed as REGISTRY/library/x is docker.io's x too.
    mirror = f'[host."http://{layout.registry}"]\n  capabilities = ["pull", "resolve"]\n'
    own = f'server = "http://{layout.registry}"\n{mirror}'
    for host, text in {layout.registry: own, "_default": mirror}.items():
        (certs / host).mkdir(parents=True, exist_ok=True)
        (certs / host / "hosts.toml").write_text(text)
    (directory / "containerd.toml").write_text(
        f"""version = 2
root = "/var/lib/containerd"
state = "/run/containerd"
oom_score = 0
[grpc]
  address = "/run/containerd/containerd.sock"
[plugins."io.containerd.grpc.v1.cri"]
  sandbox_image = "{layout.registry}/rigel-k8s/pause:1"
  restrict_oom_score_adj = {json.dumps(not limits)}
  [plugins."io.containerd.grpc.v1.cri".cni]
    bin_dir = "/opt/cni/bin"
    conf_dir = "/etc/cni/net.d"
  [plugins."io.containerd.grpc.v1.cri".registry]
    config_path = "{certs}"
  [plugins."io.containerd.grpc.v1.cri".containerd.runtimes.runc]
    runtime_type = "io.containerd.runc.v2"
"""
    )


def configure_kubelet(layout: Layout, directory: Path, cgroup: str) -> None:
    """Write the kubelet's configuration."""
    resolv = directory / "resolv.conf"
    resolv.write_text(resolv_conf())
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
        "containerRuntimeEndpoint": "unix:///run/containerd/containerd.sock",
        "cgroupDriver": "cgroupfs",
        "cgroupRoot": cgroup,
        "cgroupsPerQOS": True,
        "enforceNodeAllocatable": ["pods"],
        "failSwapOn": False,
        "maxPods": 200,
        "serializeImagePulls": False,
        "resolvConf": str(resolv),
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


def resolv_conf() -> str:
    """Return the name servers, without those on loopback, which a node cannot reach."""
    lines: list[str] = []
    for path in (Path("/run/systemd/resolve/resolv.conf"), Path("/etc/resolv.conf")):
        if path.exists():
            lines = [
                line
                for line in path.read_text().splitlines()
                if line.split()[:1] == ["nameserver"] and not line.split()[1].startswith("127.")
            ]
        if lines:
            break
    return "".join(f"{line}\n" for line in lines)


def configure_cni(layout: Layout, directory: Path, index: int) -> None:
    """Write the CNI configuration and put the standard CNI programs in place."""
    import shutil

    config = {
        "cniVersion": "0.4.0",
        "name": "rigel",
        "plugins": [
            {
                # ptp, not bridge: Services on the same node need no br_netfilter, and pods hear no
                # multicast of each other, as on most real clusters.
                "type": "ptp",
                "ipMasq": False,
                "ipam": {
                    "type": "host-local",
                    "ranges": [[{"subnet": layout.addresses.pod_range(index)}]],
                    "routes": [{"dst": "0.0.0.0/0"}],
                },
            },
            {"type": "portmap", "capabilities": {"portMappings": True}},
        ],
    }
    (directory / "etc-cni/net.d").mkdir(parents=True, exist_ok=True)
    (directory / "etc-cni/net.d/10-rigel.conflist").write_text(json.dumps(config))
    programs = directory / "opt-cni/bin"
    if not programs.exists():
        shutil.copytree(layout.components.cni_plugins, programs)

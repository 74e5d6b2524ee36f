"""The control plane's machine: etcd, the API server, its controllers, and the image registry."""

from __future__ import annotations

import json
from pathlib import Path

from rigel_lab.cluster.certificates import Authority, service_account_key
from rigel_lab.cluster.layout import API_PORT, CONTROL_PLANE, SERVER, Layout
from rigel_lab.cluster.machine import Machine


def control_plane(layout: Layout) -> Machine:
    """Return the machine of etcd, the API server, its controllers, and the registry."""
    directory = layout.directory / CONTROL_PLANE
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    return Machine(
        name=CONTROL_PLANE,
        namespace=layout.namespace(CONTROL_PLANE),
        directory=directory,
        environment=layout.environment(),
        init=layout.program("catatonit"),
        services={
            "etcd": etcd(layout, directory),
            "kube-apiserver": apiserver(layout),
            "kube-controller-manager": controller_manager(layout),
            "kube-scheduler": scheduler(layout),
            "registry": registry(layout, directory),
        },
    )


def etcd(layout: Layout, directory: Path) -> list[str]:
    """Return etcd's command line: on loopback of its own namespace, which no one else shares."""
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
    ca, address = layout.authority(), layout.control_plane
    names = ["kubernetes", "kubernetes.default", "kubernetes.default.svc"]
    names += ["kubernetes.default.svc.cluster.local", "localhost"]
    alternatives = [f"DNS:{n}" for n in names]
    alternatives += [f"IP:{ip}" for ip in (address, layout.addresses.api_service, "127.0.0.1")]
    alternatives.append(f"IP:{layout.address(SERVER)}")
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
        f"--service-cluster-ip-range={layout.addresses.services}",
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
        # Debian's etcd cannot report a watch's progress (3.4.25 and later can): with this feature,
        # a watch from no or from any version (of KWOK, of scripts) would end with an error.
        "--feature-gates=WatchList=false",
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
    path = directory / "registry.yml"
    path.write_text(json.dumps(config))
    return [layout.program("docker-registry"), "serve", str(path)]

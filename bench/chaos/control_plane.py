"""The bench's own API server: etcd, the API server, the controllers of workloads, no machine."""

from __future__ import annotations

import json
import secrets
import socket
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import attrs
import urllib3
from urllib3.exceptions import InsecureRequestWarning

from rigel_k8s.errors import LocalClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.target import Credentials, Target
from rigel_lab.cluster import components
from rigel_lab.cluster.certificates import service_account_key

START = 180.0  # seconds that the API server may take
CONTROLLERS = ("deployment", "replicaset", "garbage-collector", "namespace")


@attrs.frozen
class Server:
    """An API server and its administrator's token."""

    url: str
    token: str

    def connect(self) -> Cluster:
        """Return a client with a direct connection, without faults."""
        headers = [("Authorization", f"Bearer {self.token}")]
        credentials = Credentials(headers=lambda *, fresh: headers)
        return Cluster(Target(self.url, "direct", insecure=True, credentials=lambda: credentials))


@contextmanager
def control_plane(directory: Path) -> Iterator[Server]:
    """Run an API server while the context is open; its data and logs are in the directory."""
    urllib3.disable_warnings(InsecureRequestWarning)
    found = components.obtain(print)
    client, peer, api, manager = free_ports(4)
    server = Server(f"https://127.0.0.1:{api}", secrets.token_hex(16))
    etcd = f"http://127.0.0.1:{client}"
    with ExitStack() as stack:
        for command in (
            etcd_command(found.program("etcd"), directory, etcd, f"http://127.0.0.1:{peer}"),
            api_command(found.program("kube-apiserver"), directory, etcd, api, server.token),
        ):
            stack.enter_context(running(command, directory))
        wait_until_healthy(server.url)
        command = manager_command(found.program("kube-controller-manager"), directory, server)
        stack.enter_context(running([*command, f"--secure-port={manager}"], directory))
        wait_until_healthy(f"https://127.0.0.1:{manager}")
        yield server


def etcd_command(program: str, directory: Path, url: str, peer: str) -> list[str]:
    """Return etcd's command line."""
    return [
        program,
        f"--data-dir={directory / 'etcd'}",
        f"--listen-client-urls={url}",
        f"--advertise-client-urls={url}",
        f"--listen-peer-urls={peer}",
        f"--initial-advertise-peer-urls={peer}",
        f"--initial-cluster=default={peer}",
        "--unsafe-no-fsync",
        "--log-level=error",
    ]


def api_command(program: str, directory: Path, etcd: str, port: int, token: str) -> list[str]:
    """Return the API server's command line; nothing in it is kept after the bench."""
    private, public = service_account_key(directory)
    tokens = directory / "tokens.csv"
    tokens.touch(mode=0o600)
    tokens.write_text(f'{token},bench,bench,"system:masters"\n')
    return [
        program,
        f"--etcd-servers={etcd}",
        "--bind-address=127.0.0.1",
        f"--secure-port={port}",
        f"--cert-dir={directory}",
        "--service-cluster-ip-range=10.0.0.0/16",
        f"--token-auth-file={tokens}",
        "--authorization-mode=RBAC",
        "--disable-admission-plugins=ServiceAccount",
        "--service-account-issuer=https://bench",
        f"--service-account-key-file={public}",
        f"--service-account-signing-key-file={private}",
    ]


def manager_command(program: str, directory: Path, server: Server) -> list[str]:
    """Write a kubeconfig, and return the controller manager's command line."""
    path = directory / "manager.kubeconfig"
    path.write_text(json.dumps(kubeconfig(server.url, server.token, insecure=True)))
    return [
        program,
        f"--kubeconfig={path}",
        "--bind-address=127.0.0.1",
        f"--cert-dir={directory}",
        "--leader-elect=false",
        "--controllers=" + ",".join(f"{name}-controller" for name in CONTROLLERS),
        "--kube-api-qps=500",
        "--kube-api-burst=1000",
    ]


def kubeconfig(url: str, token: str, *, insecure: bool = False) -> dict[str, object]:
    """Return a kubeconfig of one context."""
    cluster: dict[str, object] = {"server": url}
    if insecure:
        cluster["insecure-skip-tls-verify"] = True
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": "chaos", "cluster": cluster}],
        "users": [{"name": "chaos", "user": {"token": token}}],
        "contexts": [{"name": "chaos", "context": {"cluster": "chaos", "user": "chaos"}}],
        "current-context": "chaos",
    }


def free_ports(number: int) -> Sequence[int]:
    """Return ports of this machine that are free now."""
    with ExitStack() as stack:
        sockets = [
            stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(number)
        ]
        return [one.getsockname()[1] for one in sockets]


@contextmanager
def running(command: Sequence[str], directory: Path) -> Iterator[None]:
    """Run a program while the context is open; its log is beside its data."""
    log = directory / f"{Path(command[0]).name}.log"
    with log.open("ab") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)
        try:
            yield
        finally:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


def wait_until_healthy(url: str) -> None:
    """Wait until a program reports that all of its parts work.

    Raises:
        LocalClusterError: it does not do so in time.
    """
    end = time.monotonic() + START
    with urllib3.PoolManager(cert_reqs="CERT_NONE", retries=False, timeout=10) as http:
        while True:
            with suppress(urllib3.exceptions.HTTPError):
                if http.request("GET", f"{url}/healthz").status == 200:
                    return
            if time.monotonic() > end:
                raise LocalClusterError(f"{url} was not healthy after {START:g} s")
            time.sleep(0.3)

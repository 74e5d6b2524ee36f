"""The life of a local cluster: up, down, status, load; each may be said again at any time."""

from __future__ import annotations

import json
import os
import platform
import shutil
import ssl
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import attrs
import urllib3

from rigel_k8s.errors import CommandFailed, LocalClusterError, UserError
from rigel_k8s.localcluster import addons, addresses, components, host, kubeconfig, machines, oci
from rigel_k8s.localcluster.components import KUBERNETES_VERSION, Report, run
from rigel_k8s.localcluster.machine import Machine, Process, running_in

__all__ = ["DEFAULT_NAME", "ClusterStatus", "NodeStatus", "down", "load", "status", "up"]

DEFAULT_NAME = "local"
PROGRAMS = {
    "ip": "iproute2",
    "nft": "nftables",
    "iptables": "iptables",
    "nsenter": "util-linux",
    "unshare": "util-linux",
    "openssl": "openssl",
}


@attrs.frozen
class NodeStatus:
    """A node: its name, its address on the segment, whether the cluster calls it Ready."""

    name: str
    address: str
    ready: bool


@attrs.frozen
class ClusterStatus:
    """A local cluster as it is now.

    Attributes:
        running: whether all its machines run and the API server answers.
        registry: HOST:PORT to push to and to pull from, plain HTTP.
        logs: the directory below which every component's log is.
    """

    name: str
    context: str
    running: bool
    server: str
    registry: str
    kubernetes: str
    nodes: tuple[NodeStatus, ...]
    logs: str
    kubectl: str


@attrs.define
class State:
    """What is remembered of a cluster between two commands."""

    name: str
    nodes: int
    block: str
    boot: str
    kubeconfig: str
    previous_context: str | None = None
    kubernetes: str = KUBERNETES_VERSION
    processes: dict[str, list[int]] = attrs.field(factory=dict)

    @property
    def directory(self) -> Path:
        """The cluster's directory."""
        return directory_of(self.name)

    def save(self) -> None:
        """Write it."""
        self.directory.mkdir(parents=True, exist_ok=True)
        (self.directory / "cluster.json").write_text(json.dumps(attrs.asdict(self), indent=2))

    @classmethod
    def load(cls, name: str) -> State | None:
        """Return what is remembered of a cluster, None where there is none."""
        path = directory_of(name) / "cluster.json"
        return cls(**json.loads(path.read_text())) if path.exists() else None

    def process(self, machine: str) -> Process | None:
        """Return a machine's process where it still runs."""
        if recorded := self.processes.get(machine):
            process = Process(*recorded)
            return process if process.alive else None
        return None

    @property
    def machine_names(self) -> list[str]:
        """All machines, the control plane first."""
        return ["control-plane", *(f"node{i}" for i in range(1, self.nodes + 1))]


def directory_of(name: str) -> Path:
    """Return where a cluster keeps its state."""
    return host.STATE / "clusters" / name


def context_of(name: str) -> str:
    """Return the kubeconfig context of a cluster."""
    return f"rigel-{name}"


def boot_id() -> str:
    """Return what changes with every boot of this machine."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def require_host() -> None:
    """Refuse a machine on which this cannot work, with what works there.

    Raises:
        UserError: not Linux, not root, or a program is missing.
    """
    elsewhere = "or use kind, minikube or k3s: rigel works with any cluster of your kubeconfig"
    if platform.system() != "Linux":
        raise UserError("the local cluster needs Linux", hint=elsewhere)
    if os.geteuid() != 0:
        raise UserError(
            "the local cluster needs root: it makes namespaces, a bridge and cgroups",
            hint=f"run it with sudo, {elsewhere}",
        )
    missing = sorted({package for p, package in PROGRAMS.items() if not shutil.which(p)})
    if missing:
        raise UserError(
            f"the local cluster needs {', '.join(missing)}",
            hint=f"apt-get install {' '.join(missing)}",
        )


def check_name(name: str) -> None:
    """Refuse a name that cannot be part of a context, an interface or a path."""
    if not (name.isascii() and name.replace("-", "").isalnum() and name[0].isalpha()):
        raise UserError(f'"{name}" is no name for a cluster: letters, digits and "-" only')
    if name != name.lower() or len(name) > 30:
        raise UserError(f'"{name}" is no name for a cluster: lower case, at most 30 characters')


@contextmanager
def exclusive(name: str) -> Iterator[None]:
    """Let one command at a time work on a cluster."""
    import fcntl

    directory = host.STATE / "clusters"
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f".{name}.lock"
    with path.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise LocalClusterError(
                f"another rigel is working on the cluster {name}", hint="wait until it has ended"
            ) from error
        try:
            yield
        finally:
            path.unlink(missing_ok=True)
            with suppress(OSError):
                directory.rmdir()
                host.STATE.rmdir()


def up(name: str = DEFAULT_NAME, nodes: int = 2, *, report: Report) -> ClusterStatus:
    """Start a cluster, or what of it does not run, and return it.

    A cluster of an earlier boot is made anew: its etcd does not sync to disk.

    Raises:
        UserError: this machine cannot, or a running cluster has another number of nodes.
        LocalClusterError, CommandFailed: a part did not start; what was started stays for a look
            at its logs and is removed by `down`.
    """
    require_host()
    check_name(name)
    with exclusive(name):
        state = usable_state(name, nodes, report)
        parts = components.obtain(report)
        state = state or new_state(name, nodes)
        state.save()
        layout = layout_of(state, parts)
        host.acquire(name)
        started = start_machines(state, layout, report)
        if started:
            furnish(state, layout, report)
        merge_kubeconfig(state, layout)
        if not started:
            report(f"Cluster {name} is running already")
        return status(name)


def usable_state(name: str, nodes: int, report: Report) -> State | None:
    """Return the state of a cluster that can go on; one of an earlier boot is removed."""
    state = State.load(name)
    if state and state.boot != boot_id():
        report(f"Cluster {name} was lost when this machine restarted; making it anew")
        remove(state)
        return None
    if state and state.nodes != nodes:
        raise UserError(
            f"cluster {name} has {state.nodes} nodes, not {nodes}",
            hint=f"rigel cluster down --name {name}, then up again",
        )
    return state


def new_state(name: str, nodes: int) -> State:
    """Return the state of a cluster to be, with address ranges that nobody uses."""
    if nodes < 1 or nodes > 50:
        raise UserError(f"a cluster of {nodes} nodes: 1 to 50 are possible")
    return State(
        name=name,
        nodes=nodes,
        block=addresses.choose().block,
        boot=boot_id(),
        kubeconfig=str(kubeconfig.user_kubeconfig().absolute()),
    )


def layout_of(state: State, parts: components.Components) -> machines.Layout:
    """Return the layout of a remembered cluster."""
    return machines.Layout(state.name, state.directory, addresses.Addresses(state.block), parts)


def start_machines(state: State, layout: machines.Layout, report: Report) -> bool:
    """Start every machine that does not run; return whether there was one."""
    missing = [m for m in state.machine_names if not state.process(m)]
    if not missing:
        return False
    host.network_create(state.name, layout.addresses)
    for name in missing:
        index = state.machine_names.index(name)
        number = machines.CONTROL_PLANE if index == 0 else machines.FIRST_NODE - 1 + index
        for left in running_in(host.netns_name(state.name, name)):
            left.kill()
        host.wire(state.name, name, number, layout.addresses)
    add_routes(state, layout)
    for name in missing:
        report(f"Starting {name}")
        start_machine(state, layout, name)
        if name == "control-plane":
            wait_for_api(state, layout)
            push_images(layout, report)
            create_nodes(state, layout)
    return True


def start_machine(state: State, layout: machines.Layout, name: str) -> None:
    """Start one machine and remember its process."""
    machine = machine_of(state, layout, name)
    process = machine.start()
    state.processes[name] = [process.pid, process.start]
    state.save()


def machine_of(state: State, layout: machines.Layout, name: str) -> Machine:
    """Return what a machine is."""
    if name == "control-plane":
        return machines.control_plane(layout)
    cgroup = host.cgroup_create(state.name, name)
    return machines.node(layout, int(name.removeprefix("node")), cgroup=cgroup, limits=may_limit())


def may_limit() -> bool:
    """Return whether this machine gives us CAP_SYS_RESOURCE (bit 24)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> 24 & 1)
    return False


def add_routes(state: State, layout: machines.Layout) -> None:
    """Give every machine a route to every other node's pods."""
    for machine in state.machine_names:
        inside = ["ip", "-n", host.netns_name(state.name, machine)]
        for index in range(1, state.nodes + 1):
            if machine != f"node{index}":
                via = layout.addresses.machine(machines.FIRST_NODE - 1 + index)
                run([*inside, "route", "replace", layout.addresses.pod_range(index), "via", via])


def wait_for_api(state: State, layout: machines.Layout, seconds: float = 90) -> None:
    """Wait until the API server says that it is ready.

    Raises:
        LocalClusterError: it does not within the time; the details are its last log lines.
    """
    deadline = time.monotonic() + seconds
    while not api_ready(layout):
        if time.monotonic() > deadline:
            log = state.directory / "control-plane" / "logs" / "kube-apiserver.log"
            raise LocalClusterError(
                f"the API server was not ready after {seconds:.0f} s",
                details=log.read_text().splitlines()[-10:] if log.exists() else (),
                hint=f"its log: {log}",
            )
        time.sleep(0.1)


def api_ready(layout: machines.Layout) -> bool:
    """Return whether /readyz answers ok."""
    context = ssl.create_default_context(cafile=str(layout.authority().certificate))
    http = urllib3.PoolManager(ssl_context=context, retries=False, timeout=2)
    try:
        return http.request("GET", f"{layout.server}/readyz").status == 200
    except urllib3.exceptions.HTTPError:
        return False


def push_images(layout: machines.Layout, report: Report) -> None:
    """Put the cluster's own images into its registry."""
    report("Filling the registry")
    deadline = time.monotonic() + 30
    for image in addons.images(layout.components):
        while True:
            try:
                oci.push(image, layout.registry)
                break
            except urllib3.exceptions.HTTPError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)


def admin(layout: machines.Layout) -> Path:
    """Return the administrator's kubeconfig."""
    return layout.kubeconfig("admin", "kubernetes-admin", "system:masters")


def kubectl(layout: machines.Layout, *words: str) -> str:
    """Run kubectl as administrator and return what it printed."""
    return run([layout.program("kubectl"), f"--kubeconfig={admin(layout)}", *words])


def create_nodes(state: State, layout: machines.Layout) -> None:
    """Create the Node objects with their pod ranges; the kubelets find and fill them."""
    items = [
        {
            "apiVersion": "v1",
            "kind": "Node",
            "metadata": {"name": f"node{i}", "labels": {"kubernetes.io/hostname": f"node{i}"}},
            "spec": {
                "podCIDR": layout.addresses.pod_range(i),
                "podCIDRs": [layout.addresses.pod_range(i)],
            },
        }
        for i in range(1, state.nodes + 1)
    ]
    path = state.directory / "nodes.json"
    path.write_text(json.dumps({"apiVersion": "v1", "kind": "List", "items": items}))
    with suppress(CommandFailed):  # AlreadyExists, where the control plane was started again
        kubectl(layout, "create", "-f", str(path))


def furnish(state: State, layout: machines.Layout, report: Report) -> None:
    """Install DNS and storage, and wait until nodes and both are ready."""
    report("Installing DNS and storage")
    path = addons.write(layout)
    kubectl(layout, "apply", "--server-side", "--force-conflicts", "-f", str(path))
    report(f"Waiting for {state.nodes} nodes")
    kubectl(layout, "wait", "node", "--all", "--for=condition=Ready", "--timeout=120s")
    report("Waiting for DNS and storage")
    for space, name in (
        ("kube-system", addons.DNS_NAME),
        (addons.STORAGE_NAMESPACE, "local-path-provisioner"),
    ):
        kubectl(layout, "-n", space, "rollout", "status", f"deployment/{name}", "--timeout=120s")


def merge_kubeconfig(state: State, layout: machines.Layout) -> None:
    """Put the context into the user's kubeconfig."""
    previous = kubeconfig.merge(
        Path(state.kubeconfig), context_of(state.name), user_entries(state.name, layout)
    )
    if previous and not state.previous_context:
        state.previous_context = previous
        state.save()


def user_entries(name: str, layout: machines.Layout) -> dict[str, Any]:
    """Return the kubeconfig of a cluster's administrator."""
    ca = layout.authority()
    admin(layout)
    certificate, key = ca.directory / "admin.crt", ca.directory / "admin.key"
    return kubeconfig.entries(context_of(name), layout.server, ca.certificate, certificate, key)


def down(name: str = DEFAULT_NAME, *, report: Report) -> bool:
    """End a cluster and remove everything of it; return whether there was one."""
    require_host()
    check_name(name)
    with exclusive(name):
        state = State.load(name)
        if not state:
            return False
        report(f"Removing cluster {name}")
        remove(state)
        return True


def remove(state: State) -> None:
    """End a cluster's processes and take away what it made, in whatever condition it is."""
    if state.boot == boot_id():
        for machine in reversed(state.machine_names):
            if process := state.process(machine):
                process.kill()
            for left in running_in(host.netns_name(state.name, machine)):
                left.kill()
    host.network_remove(state.name)
    host.cgroup_remove(state.name)
    kubeconfig.remove(Path(state.kubeconfig), context_of(state.name), state.previous_context)
    host.remove_tree(state.directory)
    host.release(state.name)


def find(name: str) -> tuple[State, machines.Layout]:
    """Return a cluster that is there.

    Raises:
        UserError: there is none of that name.
    """
    state = State.load(name)
    if not state:
        raise UserError(f"there is no local cluster {name}", hint=f"rigel cluster up --name {name}")
    return state, layout_of(state, components.obtain(lambda _: None))


def names() -> list[str]:
    """Return the names of all local clusters."""
    found = (host.STATE / "clusters").glob("*/cluster.json")
    return sorted(path.parent.name for path in found)


def status(name: str = DEFAULT_NAME) -> ClusterStatus:
    """Return a cluster as it is now.

    Raises:
        UserError: there is none of that name.
    """
    require_host()
    state, layout = find(name)
    running = all(state.process(m) for m in state.machine_names) and api_ready(layout)
    return ClusterStatus(
        name=name,
        context=context_of(name),
        running=running,
        server=layout.server,
        registry=layout.registry,
        kubernetes=f"v{state.kubernetes}",
        nodes=tuple(node_statuses(state, layout, ask=running)),
        logs=str(state.directory),
        kubectl=layout.program("kubectl"),
    )


def node_statuses(state: State, layout: machines.Layout, *, ask: bool) -> Iterator[NodeStatus]:
    """Yield each node's status; where the API server cannot be asked, none is ready."""
    ready: dict[str, bool] = {}
    if ask:
        for item in json.loads(kubectl(layout, "get", "nodes", "-o", "json"))["items"]:
            conditions = {c["type"]: c["status"] for c in item["status"].get("conditions", [])}
            ready[item["metadata"]["name"]] = conditions.get("Ready") == "True"
    for index in range(1, state.nodes + 1):
        address = layout.addresses.machine(machines.FIRST_NODE - 1 + index)
        yield NodeStatus(f"node{index}", address, ready.get(f"node{index}", False))


def kubeconfig_text(name: str = DEFAULT_NAME) -> str:
    """Return a kubeconfig of the cluster alone, as YAML."""
    import yaml

    require_host()
    _, layout = find(name)
    return yaml.safe_dump(user_entries(name, layout), sort_keys=False)


def load(images: Sequence[str], name: str = DEFAULT_NAME, *, report: Report) -> None:
    """Put images of podman or docker, or of tar files, onto every node.

    Raises:
        UserError: no such cluster, file or image.
        CommandFailed: a node refused the image.
    """
    require_host()
    state, layout = find(name)
    for image in images:
        with archive(image) as path:
            for index in range(1, state.nodes + 1):
                report(f"Loading {image} onto node{index}")
                load_on_node(state, layout, f"node{index}", path)


def load_on_node(state: State, layout: machines.Layout, node: str, path: Path) -> None:
    """Import an archive into one node's containerd."""
    process = state.process(node)
    if not process:
        raise LocalClusterError(f"{node} does not run", hint="rigel cluster up")
    socket = f"/proc/{first_inside(process)}/root/run/containerd/containerd.sock"
    run([layout.program("ctr"), "-a", socket, "-n", "k8s.io", "images", "import", str(path)])


def first_inside(process: Process) -> int:
    """Return the id, seen from the host, of the first process of a machine's PID namespace."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return int(children[0])


@contextmanager
def archive(image: str) -> Iterator[Path]:
    """Give an image as a tar file: the named file itself, or what podman or docker saves."""
    if Path(image).is_file():
        yield Path(image)
        return
    tools = [tool for tool in ("podman", "docker") if shutil.which(tool)]
    with tempfile.TemporaryDirectory(prefix="rigel-") as directory:
        path = Path(directory) / "image.tar"
        for tool in tools:
            with suppress(CommandFailed):
                run([tool, "save", "-o", str(path), image])
                yield path
                return
    tried = " nor ".join(tools) or "neither docker nor podman is installed, so nobody"
    raise UserError(f"no file and no image {image}: {tried} has it", hint="build or pull it first")

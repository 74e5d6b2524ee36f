"""The life of a local cluster: up and down; each may be repeated at any time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType

from rigel_k8s.errors import LocalClusterError
from rigel_k8s.system.cache import locked
from rigel_lab.cluster import (
    addons,
    addresses,
    api,
    cgroups,
    components,
    kubeconfig,
    machine,
    network,
    paths,
    removal,
    shared,
)
from rigel_lab.cluster.addons import Made, offer, push_images
from rigel_lab.cluster.commands import Report
from rigel_lab.cluster.control_plane import control_plane
from rigel_lab.cluster.layout import CONTROL_PLANE, Layout
from rigel_lab.cluster.machine import Machine
from rigel_lab.cluster.node import node, write_resolv_conf
from rigel_lab.cluster.requirements import check_name, require_host, require_root
from rigel_lab.cluster.state import State
from rigel_lab.cluster.status import ClusterStatus, status_of
from rigel_lab.cluster.wish import DEFAULT_NODES, Wish

DEFAULT_NAME = "local"
NOTHING_MADE: Made = MappingProxyType({})


def up(
    name: str = DEFAULT_NAME,
    nodes: int | None = None,
    *,
    extras: Sequence[str] = (),
    data_dir: str | None = None,
    made: Made = NOTHING_MADE,
    report: Report = lambda _: None,
) -> ClusterStatus:
    """Start a cluster, or those parts of it that do not run, and return it.

    A cluster of an earlier boot is recreated as it was: its etcd does not sync to disk.

    Args:
        name: of the cluster; its context is rigel-NAME.
        nodes: how many; None: as the existing cluster, else two.
        extras: what its registry offers in addition ("multus"); a running cluster gains them.
        data_dir: k3s' data directory, for nodes laid out as those of k3s.
        made: images that others make for extras; used only with the extra.
        report: called with one line for each step.

    Raises:
        UserError: this machine is not suitable, or a running cluster differs.
        LocalClusterError, CommandFailed: a part did not start; what was started stays, so that its
            logs can be read, and is removed by `down`.
    """
    require_host()
    check_name(name)
    wish = Wish(nodes, extras, data_dir)
    wish.check()
    file = kubeconfig.user_kubeconfig().absolute()
    kubeconfig.load(file)  # fails before anything is started
    with working_on(name):
        state = load_or_create(name, wish, report)
        shared.acquire(name, state.node_paths.binds)
        started = start_machines(state, report)
        # Those of a recreated cluster, or of an interrupted `up`, are missing.
        asked = wish.extras or (() if state.offers else state.extras)
        offer(state, asked, made, report)
        if started or not state.furnished:
            furnish(state, report)
        else:
            report(f"Cluster {name} is already running")
        merge_kubeconfig(state, file)
        return status_of(state)


def down(name: str = DEFAULT_NAME, *, report: Report = lambda _: None) -> bool:
    """End a cluster and remove everything of it; return whether there was one."""
    require_root()
    check_name(name)
    with working_on(name):
        state = State.load(name)
        if state:
            report(f"Removing cluster {name}")
            removal.remove(state, report)
        return state is not None


@contextmanager
def working_on(name: str) -> Iterator[None]:
    """Let one command at a time work on a cluster."""
    with locked(paths.LOCKS / f"cluster {name}.lock", wait=False):
        yield


def load_or_create(name: str, wish: Wish, report: Report) -> State:
    """Return the state of a cluster that can continue, or of a new one."""
    state = State.load(name)
    if not state:
        return create(name, wish, report)
    if state.boot != paths.boot_id():
        report(f"Cluster {name} was lost when this machine restarted; recreating it")
        removal.remove(state, report)
        return create(name, wish.complete_from(state), report)
    wish.compare(state)
    if not state.components.complete:
        there = components.obtain(report, list_builds(state))
        state.components = state.components.replace_missing(there)
        state.save()
    return state


def list_builds(of: Wish | State) -> list[str]:
    """Return the names of components.ON_REQUEST that a cluster needs."""
    return [*of.extras, *(["k3s"] if of.data_dir else [])]


def create(name: str, wish: Wish, report: Report) -> State:
    """Return the state of a new cluster, with unused address ranges."""
    parts = components.obtain(report, list_builds(wish))
    with shared.exclusive():
        others = [State.load(other) for other in paths.names()]
        state = State(
            name=name,
            nodes=wish.nodes or DEFAULT_NODES,
            block=addresses.choose([other.block for other in others if other]).block,
            boot=paths.boot_id(),
            kubernetes=components.KUBERNETES_VERSION,
            components=parts,
            extras=list(wish.extras),
            data_dir=wish.data_dir,
        )
        state.save()
    return state


def start_machines(state: State, report: Report) -> bool:
    """Start every machine that does not run; return whether there was one.

    A control plane that an interrupted `up` has started may lack images and Node objects.
    """
    missing = [name for name in state.machine_names if not state.process(name)]
    for name in state.node_names:
        if name not in missing:
            write_resolv_conf(state.directory / name)
    layout, again = state.layout, " again: it had ended" if state.furnished else ""
    if missing:
        network.create(state.name, layout.addresses)
    if CONTROL_PLANE in missing:
        report(f"Starting {CONTROL_PLANE}{again}")
        start(state, layout, CONTROL_PLANE)
    if CONTROL_PLANE in missing or not state.furnished:
        report("Filling the registry and waiting for the API server")
        push_images(layout, addons.own_images(layout.components))
        api.wait_until_ready(layout)
        api.create_nodes(layout, state.node_names)
    for name in [name for name in missing if name != CONTROL_PLANE]:
        report(f"Starting {name}{again}")
        if state.furnished:
            api.mark_lost(layout, name)
        start(state, layout, name)
    return bool(missing)


def start(state: State, layout: Layout, name: str) -> None:
    """Start one machine, in a namespace of its own that is connected to the segment."""
    machine.end(state.directory / name, layout.namespace(name))
    if name != CONTROL_PLANE:  # a kubelet takes 3 s for each cgroup of a container that has ended
        cgroups.remove(state.name, name)
    network.wire(layout, name)
    network.route(layout, name, state.node_names)
    make_machine(layout, name).start()


def make_machine(layout: Layout, name: str) -> Machine:
    """Return a machine's definition."""
    if name == CONTROL_PLANE:
        return control_plane(layout)
    return node(layout, name, cgroup=cgroups.create(layout.name, name), mtu=network.mtu())


def furnish(state: State, report: Report) -> None:
    """Install DNS and storage, and wait until nodes and both are ready."""
    layout = state.layout
    report("Installing DNS and storage")
    api.apply(layout, addons.describe_objects(layout))
    report("Waiting for the nodes to be Ready")
    wait_for_nodes(layout, state.node_names)
    report("Waiting for DNS and storage")
    for space, name in addons.DEPLOYMENTS:
        api.wait_for_deployment(layout, space, name)
    state.furnished = True
    state.save()


def wait_for_nodes(layout: Layout, nodes: list[str], seconds: float = 120) -> None:
    """Wait until every node is Ready.

    Raises:
        LocalClusterError: one is not within the time; the details are its kubelet's last lines.
    """
    deadline = time.monotonic() + seconds
    while late := set(nodes) - api.find_ready_nodes(layout):
        if time.monotonic() > deadline:
            name = min(late)
            log = layout.directory / name / "logs/kubelet.log"
            raise LocalClusterError(
                f"{name} was not Ready after {seconds:.0f} s",
                details=log.read_text().splitlines()[-10:] if log.exists() else (),
                hint=f"its logs: {log.parent}",
            )
        time.sleep(0.2)


def merge_kubeconfig(state: State, file: Path) -> None:
    """Put the context into the user's kubeconfig and make it current, as kind does."""
    with shared.exclusive():
        before = kubeconfig.merge(file, state.context, api.access(state.layout, state.context))
    if before or str(file) not in state.kubeconfigs:
        state.kubeconfigs[str(file)] = before
        state.save()

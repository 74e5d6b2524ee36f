"""The present state of a local cluster, without changing it."""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.yaml_text import document
from rigel_lab.cluster import api, paths
from rigel_lab.cluster.requirements import require_root
from rigel_lab.cluster.state import State, find


@attrs.frozen
class NodeStatus:
    """A node: its name, its address on the segment, whether the cluster reports it as Ready."""

    name: str
    address: str
    ready: bool


@attrs.frozen
class ClusterStatus:
    """The present state of a local cluster.

    Attributes:
        running: whether all its machines run and the API server answers.
        registry: HOST:PORT to push to and to pull from, plain HTTP.
        kubernetes: the version, as `v1.37.2`.
        kubectl: the path of a kubectl of the same version; "" without `--with kubectl`.
        logs: the directory below which every component's log is.
        problems: what does not run, one line each.
        extras: what it offers on request (`--with`).
        offers: the images of those, by the names under which nodes pull them.
    """

    name: str
    context: str
    running: bool
    server: str
    registry: str
    kubernetes: str
    nodes: tuple[NodeStatus, ...]
    kubectl: str
    logs: str
    problems: tuple[str, ...] = ()
    extras: tuple[str, ...] = ()
    offers: tuple[str, ...] = ()


def status(name: str) -> ClusterStatus:
    """Return the present state of a cluster.

    Raises:
        UserError: no cluster has that name.
    """
    require_root()
    return status_of(find(name))


def status_of(state: State) -> ClusterStatus:
    """Return the present state of a stored cluster."""
    layout = state.layout
    problems = tuple(find_troubles(state))
    return ClusterStatus(
        name=state.name,
        context=state.context,
        running=not problems,
        server=layout.server,
        registry=layout.registry,
        kubernetes=f"v{state.kubernetes}",
        nodes=tuple(node_statuses(state, ask=not problems)),
        kubectl=state.components.go.get("kubectl", ""),
        logs=str(state.directory),
        problems=problems,
        extras=tuple(state.extras),
        offers=tuple(state.offers),
    )


def find_troubles(state: State) -> Iterator[str]:
    if state.boot != paths.boot_id():
        yield "this machine was restarted"
        return
    ended = [name for name in state.machine_names if not state.process(name)]
    yield from (f"{name} has ended" for name in ended)
    if not ended and not api.is_ready(state.layout):
        yield "the API server does not answer"


def node_statuses(state: State, *, ask: bool) -> Iterator[NodeStatus]:
    """Yield each node's status; if the API server does not answer, none is ready."""
    ready = api.find_ready_nodes(state.layout) if ask else set()
    for name in state.node_names:
        yield NodeStatus(name, state.layout.address(name), name in ready)


def registries() -> frozenset[str]:
    """Return the registries of all local clusters, HOST:PORT; any user may ask."""
    states = [State.load(name) for name in paths.names()]
    return frozenset(state.layout.registry for state in states if state)


def kubeconfig_text(name: str) -> str:
    """Return a kubeconfig of the cluster alone, as YAML."""
    require_root()
    state = find(name)
    return document(api.access(state.layout, state.context))

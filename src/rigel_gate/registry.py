"""What a ROS master keeps of nodes: who publishes, subscribes and serves what, and where they are.

It follows rosmaster's own rules (rosmaster/registrations.py), so that both always agree.
"""

from __future__ import annotations

from typing import Iterator, NamedTuple

PUBLISHER, SUBSCRIBER, SERVICE, PARAMETER = "publisher", "subscriber", "service", "parameter"
#: A new master receives publishers first: it sends each subscriber the list that it has so far,
#: and roscpp ends connections to publishers that are not on it.
KINDS = (PUBLISHER, SERVICE, SUBSCRIBER, PARAMETER)
#: The node that each roscore starts and registers itself; the topic that all nodes publish.
ROSOUT = "/rosout"


class Registration(NamedTuple):
    """One thing that a node has registered.

    Attributes:
        kind: one of KINDS; PARAMETER is a subscription to a parameter.
        key: the topic, service or parameter, in full.
        node: the node's name.
        api: the URI of the node's slave API.
        detail: a topic's type, a service's own URI, empty for a parameter.
    """

    kind: str
    key: str
    node: str
    api: str
    detail: str

    @property
    def host(self) -> str:
        """The address that the node advertises."""
        return host_of(self.api)


class NodeEntry:
    """A node, and all that it has registered.

    Attributes:
        hands_over: it came by the door of nodes that hand their names over.
    """

    def __init__(self, name: str, api: str) -> None:
        self.name = name
        self.api = api
        self.hands_over = False
        self.registrations: dict[tuple[str, str], Registration] = {}

    @property
    def host(self) -> str:
        """The address that it advertises."""
        return host_of(self.api)

    def all(self) -> list[Registration]:
        """Return its registrations, in the order in which a master receives them.

        Its log comes after its other topics, whose subscribers receive from no one meanwhile.
        """
        return sorted(
            self.registrations.values(), key=lambda one: (KINDS.index(one.kind), one.key == ROSOUT)
        )


class Registry:
    """All nodes by name."""

    def __init__(self) -> None:
        self.nodes: dict[str, NodeEntry] = {}

    def register(self, one: Registration, *, hands_over: bool) -> None:
        """Add a registration; a node of that name at another URI is removed, as in the master."""
        entry = self.nodes.get(one.node)
        if entry is None or entry.api != one.api:
            entry = self.nodes[one.node] = NodeEntry(one.node, one.api)
        entry.hands_over = entry.hands_over or hands_over
        entry.registrations[one.kind, one.key] = one

    def has(self, one: Registration) -> bool:
        """Return whether exactly this registration is there."""
        entry = self.nodes.get(one.node)
        return entry is not None and entry.registrations.get((one.kind, one.key)) == one

    def unregister(self, kind: str, key: str, node: str, uri: str) -> None:
        """Remove a registration; a service's `uri` is its own, else it is the node's."""
        entry = self.nodes.get(node)
        found = entry.registrations.get((kind, key)) if entry else None
        if entry is None or found is None:
            return
        if uri == (found.detail if kind == SERVICE else found.api):
            del entry.registrations[kind, key]
            if not entry.registrations:
                del self.nodes[node]

    def forget(self, node: str) -> None:
        self.nodes.pop(node, None)

    def api_of(self, node: str) -> str | None:
        """Return where a node is, None for an unknown one."""
        entry = self.nodes.get(node)
        return entry.api if entry else None

    def all(self) -> list[Registration]:
        """Return every registration, in the order in which a new master receives them."""
        found = [one for entry in self.nodes.values() for one in entry.registrations.values()]
        return sorted(found, key=lambda one: KINDS.index(one.kind))

    def find(self, kind: str, key: str) -> Iterator[Registration]:
        """Yield the registrations of one topic, service or parameter."""
        for entry in self.nodes.values():
            if (kind, key) in entry.registrations:
                yield entry.registrations[kind, key]


def host_of(api: str) -> str:
    """Return the host of an http URI: `http://10.1.0.3:4711/` is at 10.1.0.3."""
    place = api.partition("://")[2].partition("/")[0]
    return place.rpartition(":")[0] or place


def resolve_name(name: str, node: str) -> str:
    """Return a name in full, as the master resolves what `node` writes."""
    if name.startswith("~"):
        name = f"{node}/{name[1:]}"
    elif not name.startswith("/"):
        name = f"{node.rpartition('/')[0]}/{name}"
    return "/" + "/".join(part for part in name.split("/") if part)

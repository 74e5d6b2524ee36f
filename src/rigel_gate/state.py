"""Everything that the gate keeps, changed by events alone.

An event is a list that JSON can hold, so it can be written down and read back by a gate that
starts later: a state is the result of its events on an empty one. Pure: it calls nothing.
"""

from __future__ import annotations

import json
import xmlrpc.client
from typing import Any, Iterable, Iterator, List, NamedTuple

from rigel_gate.parameters import Parameters, copy_tree, list_pieces
from rigel_gate.registry import KINDS, NodeEntry, Registration, Registry

Event = List[Any]
#: Characters of a word that are written at once.
PIECE = 2**18


class WrittenEvent(List[Any]):
    """An event whose line is made already, in a thread: it is a large one."""

    def __init__(self, event: Event) -> None:
        super().__init__(event)
        self.line = line_of(event)


def line_of(event: Event) -> bytes:
    if isinstance(event, WrittenEvent):
        return event.line
    text = "[" + ", ".join(map(_quote, event)) + "]\n"
    return text.encode("utf-8", "surrogatepass")


def _quote(word: Any) -> str:
    """Return a word as JSON; a large one in pieces, as no other thread runs within one."""
    if not isinstance(word, str) or len(word) < PIECE:
        return json.dumps(word, ensure_ascii=False)
    starts = range(0, len(word), PIECE)
    pieces = (json.dumps(word[at : at + PIECE], ensure_ascii=False)[1:-1] for at in starts)
    return '"' + "".join(pieces) + '"'


class GatePod(NamedTuple):
    """A pod that hands over, as its probe describes it.

    Attributes:
        host: the address that its nodes advertise.
        name: the pod's name.
        workload: the Deployment that it belongs to.
    """

    host: str
    name: str
    workload: str


class Newcomer(NodeEntry):
    """A node that waits for a name.

    Attributes:
        quiet_since: when it last registered anything, by the gate's clock; not kept.
        is_silent: whether its machine could not be reached at the last look; not kept.
    """

    quiet_since = 0.0
    is_silent = False


#: The event that only says how many others there were: the first and the last of a state.
REVISION = "revision"
#: How many words each event has after its name. All are texts; a `register` ends with yes or no.
WORDS = {
    REVISION: 1,
    **{"run": 1, "set": 2, "delete": 1, "register": 6, "unregister": 4, "forget": 1, "silent": 1},
    **{"answers": 1, "wait": 5, "unwait": 4, "dismiss": 2, "pod": 3, "leave": 1, "away": 1},
}


def check(event: Any) -> None:
    """Raise ValueError for an event that no gate of this version writes."""
    if not isinstance(event, list) or not event or WORDS.get(str(event[0])) != len(event) - 1:
        raise ValueError(f"not an event: {event!r:.200}")
    name, *texts = event
    if name == "register" and not isinstance(texts.pop(), bool):
        raise ValueError("the last word of register is not true or false")
    if not all(isinstance(one, str) for one in texts):
        raise ValueError(f"a word of {name} is not a text")
    if name in ("register", "wait") and texts[0] not in KINDS:
        raise ValueError(f"an unknown kind of registration: {texts[0]:.200}")


class State:
    """What the master has, which nodes wait, and which pods there are.

    Attributes:
        registry, parameters: what the master has.
        newcomers: by (node, api), the latest last.
        pods: those that hand over, by host.
        leaving: hosts whose pods are about to end.
        silent: nodes that the master does not have, since they did not answer when it returned.
        run: the /run_id of the master with which all this was registered, "" if it has none.
        revision: how many events have made it, in all gates: of two copies the higher one is newer.
        left_out: how many events of an earlier gate could not be read; not kept.
    """

    def __init__(self) -> None:
        self.registry = Registry()
        self.parameters = Parameters()
        self.newcomers: dict[tuple[str, str], Newcomer] = {}
        self.pods: dict[str, GatePod] = {}
        self.leaving: set[str] = set()
        self.silent: set[str] = set()
        self.run = ""
        self.revision = 0
        self.left_out = 0

    def apply(self, event: Event) -> None:
        getattr(self, f"_on_{event[0]}")(*event[1:])
        self.revision += event[0] != REVISION

    def set_parameter(self, key: str, value: Any, size: int) -> None:
        """Apply the event `set` with a value that is unpacked and measured already."""
        self.parameters.set(key, value, size)
        self.revision += 1

    def events(self) -> Iterable[Event]:
        """Return events that produce this state from an empty one: as it is now.

        Another thread may iterate over them, again and again, while the state changes.
        """
        return _Events(self)

    def newcomers_for(self, node: str) -> list[Newcomer]:
        """Return the newcomers that wait for a name, the latest first."""
        return [one for one in reversed(list(self.newcomers.values())) if one.name == node]

    def newcomers_at(self, host: str) -> list[Newcomer]:
        return [one for one in self.newcomers.values() if one.host == host]

    def has_node(self, api: str) -> bool:
        """Return whether a node at this URI has a name, or waits for one."""
        named = {one.api for one in self.registry.nodes.values()}
        return api in named or api in {one.api for one in self.newcomers.values()}

    # -- events --

    def _on_revision(self, number: str) -> None:
        self.revision = int(number)

    def _on_run(self, run: str) -> None:
        self.run = run

    def _on_set(self, key: str, packed: str) -> None:
        self.parameters.set(key, unpack(packed))

    def _on_delete(self, key: str) -> None:
        self.parameters.delete(key)

    def _on_register(
        self,
        kind: str,
        key: str,
        node: str,
        api: str,
        detail: str,
        hands_over: bool,  # noqa: FBT001 - an event's last word
    ) -> None:
        if self.registry.api_of(node) != api:
            self.silent.discard(node)
        self.registry.register(Registration(kind, key, node, api, detail), hands_over=hands_over)

    def _on_unregister(self, kind: str, key: str, node: str, uri: str) -> None:
        self.registry.unregister(kind, key, node, uri)

    def _on_forget(self, node: str) -> None:
        self.registry.forget(node)
        self.silent.discard(node)

    def _on_silent(self, node: str) -> None:
        self.silent.add(node)

    def _on_answers(self, node: str) -> None:
        self.silent.discard(node)

    def _on_wait(self, kind: str, key: str, node: str, api: str, detail: str) -> None:
        newcomer = self.newcomers.setdefault((node, api), Newcomer(node, api))
        newcomer.registrations[kind, key] = Registration(kind, key, node, api, detail)

    def _on_unwait(self, kind: str, key: str, node: str, api: str) -> None:
        newcomer = self.newcomers.get((node, api))
        if newcomer:
            newcomer.registrations.pop((kind, key), None)
            if not newcomer.registrations:
                del self.newcomers[node, api]

    def _on_dismiss(self, node: str, api: str) -> None:
        self.newcomers.pop((node, api), None)

    def _on_pod(self, host: str, name: str, workload: str) -> None:
        known = self.pods.get(host)
        if known and known.name != name:
            self.leaving.discard(host)
        self.pods[host] = GatePod(host, name, workload)

    def _on_leave(self, host: str) -> None:
        self.leaving.add(host)

    def _on_away(self, host: str) -> None:
        self.pods.pop(host, None)
        self.leaving.discard(host)


class _Events:
    """The events that produce a state, from a copy of it that shares its values."""

    def __init__(self, state: State) -> None:
        self._revision = [REVISION, str(state.revision)]
        self._run = state.run
        self._tree = copy_tree(state.parameters.tree)
        self._others: list[Event] = []
        for entry in state.registry.nodes.values():
            for one in entry.registrations.values():
                self._others.append(["register", *one, entry.hands_over])
        self._others += (["silent", name] for name in sorted(state.silent))
        for newcomer in state.newcomers.values():
            self._others += (["wait", *one] for one in newcomer.registrations.values())
        self._others += (["pod", *pod] for pod in state.pods.values())
        self._others += (["leave", host] for host in sorted(state.leaving))

    def __iter__(self) -> Iterator[Event]:
        yield self._revision
        yield ["run", self._run]
        for name, value in list_pieces(self._tree) if self._tree else ():
            yield ["set", name, pack(value)]
        yield from self._others
        yield self._revision


def pack(value: Any) -> str:
    """Return a parameter's value as text that keeps its type."""
    return xmlrpc.client.dumps((value,), allow_none=True)


def unpack(text: str) -> Any:
    return xmlrpc.client.loads(text)[0][0]

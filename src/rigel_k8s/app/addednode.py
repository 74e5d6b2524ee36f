"""Options that stand for one more node: `foxglove` and `record`.

Before anything else reads the options, such a key becomes an entry of `nodes`. What a user has
written there for the same node is merged into it, so each option of a node can be set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, TypeVar

import attrs

from rigel_k8s.network.modes import mode_named
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile.expansion import Expanded
from rigel_k8s.rigelfile.findings import Finding, place
from rigel_k8s.rigelfile.source import YamlNode, lay_over, locate, node_of
from rigel_k8s.rigelfile.structure import structure

T = TypeVar("T")

#: Keys of such an option that are a node's own: their values keep their places.
OF_NODES = ("image", "placement", "tolerations")


@attrs.frozen
class TakenOut(Generic[T]):
    """A job's options without such a key.

    Attributes:
        rest: the options.
        written: the key's value.
        value: the same as an option; None if it is false or wrong, or waits for data.
    """

    rest: YamlNode
    written: YamlNode
    value: T | None
    findings: tuple[Finding, ...]

    def add_node(self, name: str, described: Mapping[str, Any]) -> Expanded:
        """Return the options with a node behind the others, unknown if the option waits.

        Args:
            described: the node as a Rigelfile has it, without what the user has written.
        """
        nodes = self.rest.value.get("nodes", attrs.evolve(self.written, value={}, raw=None))
        waits = self.written.has_hole()
        if not isinstance(nodes.value, dict) or (self.value is None and not waits):
            return Expanded(self.rest, self.findings)
        if waits:
            made = attrs.evolve(self.written, value=None, raw=None, hole=True)
        else:
            own = self.written.value if isinstance(self.written.value, dict) else {}
            made = node_of(described, self.written)
            kept = {key: own[key] for key in OF_NODES if key in own}
            made = attrs.evolve(made, value={**made.value, **kept})
        merged = lay_over(attrs.evolve(nodes, value={name: made}), nodes).value
        first = {key: merged[key] for key in nodes.value if key in merged}
        nodes = attrs.evolve(nodes, value={**first, **merged})
        return Expanded(
            attrs.evolve(self.rest, value={**self.rest.value, "nodes": nodes}), self.findings
        )


def take_out(
    node: YamlNode,
    key: str,
    kind: type[T],
    check: Callable[[T], Iterable[Problem]] = lambda _: (),
) -> TakenOut[T]:
    """Return a job's options without a key, and what that means.

    Args:
        kind: the option's class; true is the class with its defaults.
        check: yields what is wrong with the option; paths are its own.
    """
    written = node.value[key]
    rest = attrs.evolve(node, value={k: v for k, v in node.value.items() if k != key})
    found = structure(written, bool | kind | None)
    problems, value = list(found.problems), None
    if not problems and not written.has_hole() and found.value:
        value = kind() if found.value is True else found.value
        problems = list(check(value))
    return TakenOut(rest, written, value, tuple(place(written, problem) for problem in problems))


def show_all_topics(node: YamlNode) -> dict[str, Any]:
    """Return what a node needs that sees all topics: discovery servers show them on request."""
    mode = mode_named(str(locate(node, ("network", "mode")).value))
    return {"env": {"ROS_SUPER_CLIENT": "TRUE"}} if mode.asks_servers else {}

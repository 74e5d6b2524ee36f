"""Values that were accepted silently, and ended the node: each has exactly this problem."""

from __future__ import annotations

import pytest

from .shapes import problems

NODE = "package: p, executable: e"
#: The distribution, the node's options, and (kind, place, a part of the message).
CASES = [
    ("jazzy", "parameters: {n: }", "bad-parameter", "nodes.n.parameters.n", "has no value"),
    ("noetic", "parameters: {n: }", "bad-parameter", "nodes.n.parameters.n", "has no value"),
    ("jazzy", "parameters: {e: []}", "bad-parameter", "nodes.n.parameters.e", "is empty"),
    (
        "noetic",
        "parameters: {n: 99999999999}",
        "bad-parameter",
        "nodes.n.parameters.n",
        "numbers of 32 bits",
    ),
]


@pytest.mark.parametrize(("distro", "node", "kind", "place", "words"), CASES)
def test_an_input_has_this_problem(
    distro: str, node: str, kind: str, place: str, words: str
) -> None:
    network = "network: peers, " if distro == "jazzy" else ""
    text = f"{{image: r:1, {network}nodes: {{n: {{{NODE}, {node}}}}}}}"
    found = [p for p in problems(text, distro) if p.severity == "error"]
    assert [(p.kind, ".".join(map(str, p.path))) for p in found] == [(kind, place)]
    assert words in found[0].message

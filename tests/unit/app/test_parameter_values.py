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
    *(
        ("jazzy", node, "bad-parameter", f"nodes.n.{place}", "leave ros__parameters")
        for node, place in (
            ("parameters: {ros__parameters: {a: 1}}", "parameters.ros__parameters"),
            ("parameters: {n: {ros__parameters: {a: 1}}}", "parameters.n"),
            ("parameters: {/**: {ros__parameters: {a: 1}}}", "parameters./**"),
            (
                "components: {c: {package: p, plugin: b, parameters: {ros__parameters: {a: 1}}}}",
                "components.c.parameters.ros__parameters",
            ),
        )
    ),
    ("jazzy", "parameters: {~a: 1}", "bad-parameter", "nodes.n.parameters.~a", "write a"),
    ("noetic", "parameters: {_a: 1}", "bad-ros-name", "nodes.n.parameters._a", "write a"),
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


@pytest.mark.parametrize("node", ["parameters: {~a: 1, /b: 1}", "parameters: {a_b: 1}"])
def test_a_private_name_of_ros1_is_one(node: str) -> None:
    found = problems(f"{{image: r:1, nodes: {{n: {{{NODE}, {node}}}}}}}", "noetic")
    assert [p for p in found if p.severity == "error"] == []

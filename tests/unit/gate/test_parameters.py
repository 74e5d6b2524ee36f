"""The parameter tree by rosmaster's rules, names as the master resolves them, and what is lost."""

from __future__ import annotations

import random
import xmlrpc.client
from typing import Any

import pytest

from rigel_gate.parameters import Parameters, leaves, size_of
from rigel_gate.recovery import find_lost_parameters, is_same_node, list_refusals
from rigel_gate.registry import (
    PARAMETER,
    PUBLISHER,
    SERVICE,
    Registration,
    Registry,
    host_of,
    resolve_name,
)
from rigel_gate.state import State, pack, unpack


def tree(*pairs: tuple[str, Any]) -> Parameters:
    found = Parameters()
    for key, value in pairs:
        found.set(key, value)
    return found


@pytest.mark.parametrize(
    ("pairs", "expected"),
    [
        ([("/a", 1)], {"a": 1}),
        ([("/a/b/c", 1), ("/a/b/d", 2)], {"a": {"b": {"c": 1, "d": 2}}}),
        ([("/a", 1), ("/a/b", 2)], {"a": {"b": 2}}),
        ([("/a/b", 1), ("/a", 2)], {"a": 2}),
        ([("/a", {"b": 1}), ("/a/c", 2)], {"a": {"b": 1, "c": 2}}),
        ([("/a", 1), ("/", {"b": 2})], {"b": 2}),
        ([("/a", 1), ("/", 7)], {}),
        ([("//a//b/", 1)], {"a": {"b": 1}}),
    ],
)
def test_set(pairs: list[tuple[str, Any]], expected: dict[str, Any]):
    """A value replaces a namespace and a namespace a value."""
    assert tree(*pairs).tree == expected


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("/a/b", {"a": {"c": 2}, "d": 3}),
        ("/a", {"d": 3}),
        ("/", {}),
        ("/x", {"a": {"b": 1, "c": 2}, "d": 3}),
        ("/x/y/z", {"a": {"b": 1, "c": 2}, "d": 3}),
        ("/d/e", {"a": {"b": 1, "c": 2}, "d": 3}),
    ],
)
def test_delete(key: str, expected: dict[str, Any]):
    """What is not there changes nothing."""
    found = tree(("/a", {"b": 1, "c": 2}), ("/d", 3))
    found.delete(key)
    assert found.tree == expected


def test_the_size_of_a_tree_is_never_too_small():
    """Whatever replaces what; counted, it is right."""
    chance, found = random.Random(1), Parameters()
    for _ in range(2000):
        key = "".join(chance.choices(["/a", "/b", "/long"], k=chance.randrange(4)))
        value = chance.choice([1, "text", {}, {"a": {"b": 1000 * "x"}}, [[1], "x"], b"0"])
        found.delete(key) if chance.random() < 0.3 else found.set(key, value)
        assert found.size >= size_of(found.tree)
        if chance.random() < 0.1:
            found.count()
            assert found.size == size_of(found.tree)
    assert size_of({"a": xmlrpc.client.Binary(5000 * b"0")}) > 5000


def test_get():
    """{} where there is nothing, as the master answers who subscribes to it."""
    found = tree(("/a", {"b": 1}), ("/zero", 0))
    assert [found.get(key) for key in ("/a", "/a/b", "/a/x", "/a/b/c", "/zero", "/")] == [
        *({"b": 1}, 1, {}, {}, 0),
        {"a": {"b": 1}, "zero": 0},
    ]


def test_names_are_listed_as_the_master_lists_them():
    assert sorted(leaves({"a": {"b": 1, "c": {}}, "d": [1]}, "")) == ["/a/b", "/d"]


@pytest.mark.parametrize(
    "value",
    [0, True, 1.5, "text", "<&>", [], {}, {"a": [1, {"b": "ä"}]}, None, xmlrpc.client.Binary(b"x")],
)
def test_a_value_keeps_its_type(value: Any):
    """In the journal and in the object of the cluster."""
    found = unpack(pack(value))
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("name", "node", "full"),
    [
        ("/a", "/ns/node", "/a"),
        ("a", "/ns/node", "/ns/a"),
        ("a/b", "/node", "/a/b"),
        ("~a", "/ns/node", "/ns/node/a"),
        ("//a//b/", "/node", "/a/b"),
    ],
)
def test_names_are_resolved_as_the_master_does(name: str, node: str, full: str):
    assert resolve_name(name, node) == full


@pytest.mark.parametrize(
    ("api", "host"),
    [
        ("http://10.1.0.3:4711/", "10.1.0.3"),
        ("http://robot:4711", "robot"),
        ("http://robot/", "robot"),
        ("http://[fd00::1]:4711/", "[fd00::1]"),
        ("", ""),
    ],
)
def test_the_host_of_an_address(api: str, host: str):
    assert host_of(api) == host


def lost(known: Parameters, names: list[str]) -> list[tuple[str, Any]]:
    state = State()
    state.parameters = known
    return find_lost_parameters(state, names)


def test_a_master_gets_the_parameters_that_it_lacks():
    """A tree at once where it has nothing of it, else value by value; never roscore's own."""
    known = tree(("/a", {"b": 1, "c": 2}), ("/d", 3), ("/ab", 4), ("/rosdistro", "noetic\n"))
    assert lost(known, []) == [("/a", {"b": 1, "c": 2}), ("/d", 3), ("/ab", 4)]
    assert lost(known, ["/a/b", "/d", "/ab"]) == [("/a/c", 2)]
    assert lost(known, ["/a/b", "/a/c", "/d", "/ab", "/more"]) == []
    assert lost(known, ["/a", "/d", "/ab"]) == [("/a/b", 1), ("/a/c", 2)]
    assert lost(known, ["/ab", "/d"]) == [("/a", {"b": 1, "c": 2})]


def publications(*topics: str) -> list[list[str]]:
    return [[topic, "t/T"] for topic in topics]


@pytest.mark.parametrize(
    ("there", "same"),
    [
        (("/rosout", "/image", "/info"), True),
        (("/rosout", "/image", "/info", "/more"), True),
        (("/rosout", "/image"), True),  # it stops to publish, and its call is on its way
        (("/rosout",), True),  # the same, of all its topics
        (("/rosout", "/scan"), False),
        ((), False),
    ],
)
def test_a_node_is_known_by_its_topics(there: tuple[str, ...], *, same: bool):
    """All nodes publish /rosout."""
    own = [
        Registration(PUBLISHER, topic, "/camera", "http://h:1/", "t/T")
        for topic in ("/rosout", "/image", "/info")
    ]
    own.append(Registration(SERVICE, "/camera/ask", "/camera", "http://h:1/", "rosrpc://h:2"))
    assert is_same_node(own, publications(*there)) is same


def test_a_node_that_publishes_nothing_is_believed():
    assert is_same_node([], publications("/x"))
    assert is_same_node([], None)


@pytest.mark.parametrize(
    ("answers", "refusals"),
    [
        ([[[1, "", []]], [[1, "", 1]]], ["", ""]),
        ([[[1, "", []]], [[-1, "no such type", 0]]], ["", "[-1, 'no such type', 0]"]),
        (
            [{"faultCode": 1, "faultString": "bug"}, [[1, "", 0]]],
            [str({"faultCode": 1, "faultString": "bug"}), ""],
        ),
        ([-1, "not XML", 0], ["[-1, 'not XML', 0]"] * 2),
        ("text", ["text"] * 2),
    ],
)
def test_what_a_master_refuses_of_many_calls(answers: object, refusals: list[str]):
    """Each call's own answer counts; one that is no list of answers refuses them all."""
    assert list_refusals(answers, 2) == refusals


# -- the registry --

API, OTHER = "http://h:1/", "http://h:2/"
TOPIC = Registration(PUBLISHER, "/t", "/n", API, "t/T")
ASK = Registration(SERVICE, "/s", "/n", API, "rosrpc://h:3")


def registry(*ones: Registration) -> Registry:
    found = Registry()
    for one in ones:
        found.register(one, hands_over=False)
    return found


def test_a_node_at_another_address_has_nothing_of_the_old_one():
    """As in the master, which forgets all that its name had."""
    late = TOPIC._replace(key="/u", api=OTHER)
    assert registry(TOPIC, ASK, late).all() == [late]


def test_who_has_come_to_hand_over_once_hands_over():
    """A tool of the same process may use the other door."""
    found = registry()
    for hands_over in (False, True, False):
        found.register(TOPIC, hands_over=hands_over)
    assert found.nodes["/n"].hands_over
    found.register(TOPIC._replace(api=OTHER), hands_over=False)
    assert not found.nodes["/n"].hands_over


@pytest.mark.parametrize(
    ("removal", "left"),
    [
        ((PUBLISHER, "/t", "/n", API), [ASK]),
        ((PUBLISHER, "/t", "/n", OTHER), [TOPIC, ASK]),
        ((SERVICE, "/s", "/n", "rosrpc://h:3"), [TOPIC]),
        ((SERVICE, "/s", "/n", API), [TOPIC, ASK]),
        ((PARAMETER, "/t", "/n", API), [TOPIC, ASK]),
        ((PUBLISHER, "/t", "/m", API), [TOPIC, ASK]),
    ],
)
def test_only_a_nodes_own_registration_is_taken_back(
    removal: tuple[str, str, str, str], left: list[Registration]
):
    """An old process may take its leave after the new one has come."""
    found = registry(TOPIC, ASK)
    found.unregister(*removal)
    assert found.all() == left


def test_a_node_without_registrations_is_unknown():
    found = registry(TOPIC)
    found.unregister(PUBLISHER, "/t", "/n", API)
    assert found.api_of("/n") is None

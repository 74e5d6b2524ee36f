"""The parameter tree, by the rules of rosmaster's own (rosmaster/paramserver.py)."""

from __future__ import annotations

import sys
from typing import Any, Iterator

#: Levels of names and values. Python's reader and writer of XML-RPC, here and in roscore, call
#: themselves for each level, a few hundred times at most.
DEEPEST = 100
#: Bytes that all parameters may take, by `size_of`. With these a gate starts within seconds, and
#: in its 256 MiB.
LARGEST_TREE = 48 * 2**20
#: What a name in a namespace counts in bytes, and what an item of a list does: more than the memory
#: that they take, since small values take longer to read.
ENTRY, ITEM = 400, 60
#: Bytes above which a namespace is written and sent in pieces, and its members are large ones.
PIECE, SMALL = 2**20, 1000
#: What each roscore sets for itself: a new one must keep its own.
OF_ROSCORE = ("run_id", "rosdistro", "rosversion", "roslaunch")


class Parameters:
    """Parameters by their full names; a namespace is a dictionary.

    Attributes:
        size: bytes of memory that the tree takes at most, about. What is removed counts until the
            next `count`: to look at all of it takes as long as to read it.
    """

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {}
        self.size = 0

    def set(self, key: str, value: Any, size: int | None = None) -> None:
        """Set a parameter, or a whole namespace; a value in the place of a namespace is removed.

        Args:
            size: that of a value that has been set in another tree before.

        Raises:
            ValueError: it is too deep.
        """
        parts = split(key)
        if size is None and len(parts) + depth(value) > DEEPEST:
            raise ValueError(f"the parameter has more than {DEEPEST} levels")
        if not parts:
            self.tree = dict(value) if isinstance(value, dict) else {}
            self.size = size_of(self.tree) if size is None else size
            return
        place = self.tree
        for part in parts[:-1]:
            if not isinstance(place.get(part), dict):
                place[part] = {}
                self.size += ENTRY + len(part)
            place = place[part]
        place[parts[-1]] = value
        self.size += ENTRY + len(parts[-1]) + (size_of(value) if size is None else size)

    def delete(self, key: str) -> None:
        """Remove a parameter or a namespace."""
        parts = split(key)
        if not parts:
            self.tree, self.size = {}, 0
            return
        place: Any = self.tree
        for part in parts[:-1]:
            place = place.get(part)
            if not isinstance(place, dict):
                return
        place.pop(parts[-1], None)

    def count(self) -> None:
        """Find out what the tree takes."""
        self.size = size_of(self.tree)

    def get(self, key: str) -> Any:
        """Return a value, {} if it has none: the master answers subscribers like this."""
        place: Any = self.tree
        for part in split(key):
            if not isinstance(place, dict) or part not in place:
                return {}
            place = place[part]
        return place

    def own(self) -> dict[str, Any]:
        """Return what is not roscore's own, by its first name."""
        return {name: value for name, value in self.tree.items() if name not in OF_ROSCORE}


def split(key: str) -> list[str]:
    """Return the parts of a full name."""
    return [part for part in key.split("/") if part]


def depth(value: Any) -> int:
    """Return how deep lists and dictionaries are nested in a value, at most one above DEEPEST."""
    level, found = 0, [value]
    while level <= DEEPEST:
        nested = [one for one in found if isinstance(one, (dict, list))]
        if not nested:
            break
        level += 1
        found = [x for one in nested for x in (one.values() if isinstance(one, dict) else one)]
    return level


def size_of(value: Any) -> int:
    """Return the bytes of memory that a value takes, about, and more for one of many parts."""
    size, left = 0, [value]
    while left:
        one = left.pop()
        if isinstance(one, dict):
            size += ENTRY * len(one) + sum(map(len, one))
            left += one.values()
        elif isinstance(one, list):
            size += ITEM * len(one)
            left += one
        else:
            size += sys.getsizeof(one) + len(getattr(one, "data", b""))  # of a Binary
    return size


def is_same(one: Any, two: Any) -> bool:
    """Return whether two values are equal, and of the same types."""
    if type(one) is not type(two):
        return False
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(is_same(one[key], two[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(two) and all(map(is_same, one, two))
    return bool(one == two)


def copy_tree(tree: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of a tree that shares its values, which never change."""
    return {key: copy_tree(one) if isinstance(one, dict) else one for key, one in tree.items()}


def list_pieces(tree: dict[str, Any], name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (name, value) that make a tree if they are set one after the other.

    A namespace that is too large comes with its small members, and then each large one.
    """
    if size_of(tree) <= PIECE or not all(key and "/" not in key for key in tree):
        yield name or "/", tree
        return
    large = {key: value for key, value in tree.items() if size_of(value) > SMALL}
    yield name or "/", {key: value for key, value in tree.items() if key not in large}
    for key, value in large.items():
        if isinstance(value, dict):
            yield from list_pieces(value, f"{name}/{key}")
        else:
            yield f"{name}/{key}", value


def leaves(value: Any, name: str) -> Iterator[str]:
    """Yield the full names of all values below a name, as `getParamNames` lists them."""
    if not isinstance(value, dict):
        yield name
        return
    for key, inner in value.items():
        yield from leaves(inner, f"{name}/{key}")

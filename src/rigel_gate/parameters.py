"""The parameter tree, by the rules of rosmaster's own (rosmaster/paramserver.py)."""

from __future__ import annotations

import sys
from typing import Any, Iterator

#: Levels of names and values. Python's reader and writer of XML-RPC, here and in roscore, call
#: themselves for each level, a few hundred times at most.
DEEPEST = 100
#: Bytes of memory that all parameters may take. With these the gate starts in its 256 MiB.
LARGEST_TREE = 64 * 2**20
#: Bytes of memory of an entry of a namespace, without its name and its value.
ENTRY = 150
#: Bytes of memory above which a namespace is written and sent in pieces.
PIECE = 2**18
#: What each roscore sets for itself: a new one must keep its own.
OF_ROSCORE = ("run_id", "rosdistro", "rosversion", "roslaunch")


class Parameters:
    """Parameters by their full names; a namespace is a dictionary.

    Attributes:
        size: bytes of memory that the tree takes, about.
    """

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {}
        self.size = 0

    def set(self, key: str, value: Any) -> None:
        """Set a parameter, or a whole namespace; a value in the place of a namespace is removed.

        Raises:
            ValueError: it is too deep.
        """
        parts = split(key)
        if len(parts) + depth(value) > DEEPEST:
            raise ValueError(f"the parameter has more than {DEEPEST} levels")
        if not parts:
            self.tree = dict(value) if isinstance(value, dict) else {}
            self.size = size_of(self.tree)
            return
        place = self.tree
        for part in parts[:-1]:
            if not isinstance(place.get(part), dict):
                self._put(place, part, {})
            place = place[part]
        self._put(place, parts[-1], value)

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
        self._remove(place, parts[-1])

    def _put(self, place: dict[str, Any], part: str, value: Any) -> None:
        self._remove(place, part)
        place[part] = value
        self.size += size_of({part: value})

    def _remove(self, place: dict[str, Any], part: str) -> None:
        if part in place:
            self.size -= size_of({part: place.pop(part)})

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
    """Return the bytes of memory that a value takes, about."""
    size, left = 0, [value]
    while left:
        one = left.pop()
        if isinstance(one, dict):
            size += ENTRY * len(one) + sum(map(len, one))
            left += one.values()
        elif isinstance(one, list):
            size += 8 * len(one)
            left += one
        else:
            size += sys.getsizeof(one) + len(getattr(one, "data", b""))  # of a Binary
    return size


def copy_tree(tree: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of a tree that shares its values, which never change."""
    return {key: copy_tree(one) if isinstance(one, dict) else one for key, one in tree.items()}


def list_pieces(tree: dict[str, Any], name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (name, value) that make a tree: whole namespaces, unless they have more than PIECE."""
    if not tree:
        return
    if size_of(tree) <= PIECE or not all(key and "/" not in key for key in tree):
        yield name or "/", tree
        return
    for key, value in tree.items():
        if isinstance(value, dict) and value:
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

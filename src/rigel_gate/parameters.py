"""The parameter tree, by the rules of rosmaster's own (rosmaster/paramserver.py)."""

from __future__ import annotations

from typing import Any, Iterator

#: Levels of names and values. Python's reader and writer of XML-RPC, here and in roscore, call
#: themselves for each level, a few hundred times at most.
DEEPEST = 100
#: What each roscore sets for itself: a new one must keep its own.
OF_ROSCORE = ("run_id", "rosdistro", "rosversion", "roslaunch")


class Parameters:
    """Parameters by their full names; a namespace is a dictionary."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {}

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
            return
        place = self.tree
        for part in parts[:-1]:
            if not isinstance(place.get(part), dict):
                place[part] = {}
            place = place[part]
        place[parts[-1]] = value

    def delete(self, key: str) -> None:
        """Remove a parameter or a namespace."""
        parts = split(key)
        if not parts:
            self.tree = {}
            return
        place: Any = self.tree
        for part in parts[:-1]:
            place = place.get(part)
            if not isinstance(place, dict):
                return
        place.pop(parts[-1], None)

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


def leaves(value: Any, name: str) -> Iterator[str]:
    """Yield the full names of all values below a name, as `getParamNames` lists them."""
    if not isinstance(value, dict):
        yield name
        return
    for key, inner in value.items():
        yield from leaves(inner, f"{name}/{key}")

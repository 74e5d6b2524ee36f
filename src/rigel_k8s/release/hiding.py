"""Which values of a release are not shown to those who look at it; pure.

`render` prints them, since it prints what is applied, and the pods have them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

#: Variables whose values are not shown.
SECRET = re.compile("PASS|SECRET|TOKEN|KEY|CREDENTIAL", re.I)


def hide(value: Any, other: Any = None, word: str = "", key: str = "") -> Any:
    """Return options or an object without the values of variables that look like secrets.

    Args:
        other: what it is compared with.
        word: marks a hidden value that is another one there.
        key: the key that leads to the value.
    """
    if isinstance(value, Mapping):
        there = other if isinstance(other, Mapping) else {}
        return {
            name: cover(item, there.get(name), word)
            if key == "env" and is_secret(name, item)
            else hide(item, there.get(name), word, name)
            for name, item in value.items()
        }
    if isinstance(value, list | tuple):
        return list(hide_items(value, other if isinstance(other, list | tuple) else (), word, key))
    return value


def hide_items(value: Any, other: Any, word: str, key: str) -> Iterator[Any]:
    """Yield the items of a list; they are compared with those of the same name, or place."""
    names = {str(one["name"]): one for one in other if isinstance(one, Mapping) and "name" in one}
    for place, item in enumerate(value):
        if not isinstance(item, Mapping) or "name" not in item:
            yield hide(item, other[place] if place < len(other) else None, word, key)
            continue
        name = str(item["name"])
        there = names.get(name)
        if key == "env" and "value" in item and is_secret(name, item["value"]):
            yield {**item, "value": cover(item["value"], (there or {}).get("value"), word)}
        else:
            yield hide(item, there, word)


def is_secret(name: Any, value: Any) -> bool:
    """Whether a variable's value is not shown: of what only says where it comes from it is."""
    return SECRET.search(str(name)) is not None and not isinstance(value, Mapping)


def cover(value: Any, other: Any, word: str) -> str:
    """Return what is shown instead of a value."""
    return f"(hidden, {word})" if word and value != other else "(hidden)"

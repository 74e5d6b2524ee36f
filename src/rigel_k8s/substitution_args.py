"""`$(find PACKAGE)` and the like in texts: which expressions a container replaces, and which not.

rigel_inpod/substitution.py replaces them. This module only recognizes them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from rigel_k8s.option_text import split_text

EXPRESSION = re.compile(r"\$\(([^()]*)\)")
_FIND = ("find", "find-pkg-share")
_ENV = ("env", "optenv")
#: The forms that messages name.
FORMS = "$(find PACKAGE), $(env NAME) and $(optenv NAME DEFAULT)"
#: Stands for an expression while a line is split.
_MARK = re.compile("\0([0-9]+)\0")
_VARIABLE = re.compile(r"[-._a-zA-Z][-._a-zA-Z0-9]*")


def is_substituted(expression: str) -> bool:
    """Return whether a container replaces an expression: `$(find robot)`."""
    words = expression[2:-1].split()
    return (len(words) == 2 and words[0] in _FIND) or (len(words) >= 2 and words[0] in _ENV)


def is_variable(expression: str) -> bool:
    """Return whether Kubernetes may replace it: `$(POD_NAME)`."""
    return _VARIABLE.fullmatch(expression[2:-1]) is not None


def find_expressions(value: Any) -> Iterator[str]:
    """Yield the expressions in the texts of plain data: `$(...)`."""
    if isinstance(value, str):
        yield from (match[0] for match in EXPRESSION.finditer(value))
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from find_expressions(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from find_expressions(inner)


def has_substitution(value: Any) -> bool:
    """Return whether a container replaces something in plain data."""
    return any(map(is_substituted, find_expressions(value)))


def split_line(line: str) -> list[str]:
    """Split as a shell does, except expressions, which stay whole: `cat $(find robot)/a.urdf`.

    Raises:
        ValueError: a quotation mark is not closed.
    """
    found: list[str] = []

    def mark(match: re.Match[str]) -> str:
        if not is_substituted(match[0]):
            return match[0]
        found.append(match[0])
        return f"\0{len(found) - 1}\0"

    words = split_text(EXPRESSION.sub(mark, line))
    return [_MARK.sub(lambda match: found[int(match[1])], word) for word in words]

"""The form of `$(arg x)` and the like in a text, and the value of `$(eval ...)`.

What they mean depends on the place: scope.py.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

COMPARISONS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda one, many: one in many,
}


class LeftOut(Exception):
    """A tag needs what is not known or not supported here; the message is the reason."""


def replace_expressions(text: str, replace: Callable[[str], str]) -> str:
    """Return a text with each outermost `$(...)` replaced.

    Args:
        replace: returns what takes the place of an expression, of which it gets the inside.

    Raises:
        LeftOut: a parenthesis is not closed.
    """
    done, rest = "", text
    while "$(" in rest:
        before, rest = rest.split("$(", 1)
        end = _find_end(rest)
        if end is None:
            raise LeftOut(f"a closing parenthesis is missing in `{text}`")
        done, rest = done + before + replace(rest[:end]), rest[end + 1 :]
    return done + rest


def _find_end(text: str) -> int | None:
    """Return where the parenthesis that was opened before a text is closed."""
    depth = 1
    for place, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return place
    return None


def evaluate(expression: str, get: Callable[[str], Any]) -> Any:
    """Return the value of `$(eval EXPRESSION)`. Python's eval() is not used.

    It may have literals, arguments (`x` or `arg('x')`), comparisons, and, or, not, and
    `a if b else c`, lists.

    Args:
        get: returns the value of an argument; raises LeftOut if it is not known.

    Raises:
        LeftOut: it has something else, or does not fit its values.
    """
    try:
        node = ast.parse(expression.strip(), mode="eval").body
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            # in ros2 launch the whole expression is in quotation marks
            node = ast.parse(node.value.strip(), mode="eval").body
        return _compute(node, get)
    except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError) as error:
        raise LeftOut(f"`$(eval {expression})`: {error}") from None


def _compute(node: ast.expr, get: Callable[[str], Any]) -> Any:
    match node:
        case ast.Constant(value=str() | int() | float()):
            return node.value
        case ast.List(elts=parts) | ast.Tuple(elts=parts):
            return [_compute(part, get) for part in parts]
        case ast.Name(id="true" | "false"):
            return node.id == "true"
        case (
            ast.Name(id=name)
            | ast.Call(func=ast.Name(id="arg"), args=[ast.Constant(value=str(name))])
        ):
            return get(name)
        case ast.UnaryOp(op=ast.Not(), operand=part):
            return not _compute(part, get)
        case ast.IfExp(test=test, body=body, orelse=other):
            return _compute(body if _compute(test, get) else other, get)
        case ast.BoolOp(op=op, values=[*parts, last]):
            for part in parts:
                value = _compute(part, get)
                if bool(value) is isinstance(op, ast.Or):
                    return value
            return _compute(last, get)
        case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in COMPARISONS:
            return COMPARISONS[type(op)](_compute(left, get), _compute(right, get))
    raise ValueError(f"`{ast.unparse(node)}` is not evaluated here: write its value")

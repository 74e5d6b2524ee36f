"""Expressions in templates: filters and arithmetic, through jinja2's sandbox.

jinja2 would read `vars.base-image` as a subtraction and `vars.items` as a method, so it never sees
these names: each is looked up here and passed on under a name of its own. Its sandbox shields
Python from an expression; time and memory are limited by spending.py. Import this module only
when a file has an expression; jinja2 takes longer to import than the rest of a check.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

import attrs
from jinja2 import Environment, StrictUndefined, TemplateError, TemplateSyntaxError, UndefinedError
from jinja2.sandbox import ImmutableSandboxedEnvironment

from rigel_k8s.rigelfile.findings import name_nearest
from rigel_k8s.rigelfile.limits import LONGEST_EXPRESSION, MOST_BITS, MOST_VALUES

_REFERENCE = re.compile(
    r"""(?P<quoted>'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")
      | (?<![\w.]) (?P<header>vars|data)
        (?: \.(?P<name>[a-zA-Z0-9_\-!?.]+) | \[\s*(?P<quote>['"])(?P<item>.*?)(?P=quote)\s*\] )""",
    re.VERBOSE | re.DOTALL,
)
_UNKNOWN_NAME = re.compile(r"[\w-]*\w")
_PREFIX = "rigel_"
#: Filters for HTML, for debugging, and those whose result differs from run to run.
LEFT_OUT = frozenset(
    ("attr", "e", "escape", "forceescape", "pprint", "random", "safe", "striptags", "urlize")
    + ("wordwrap", "xmlattr")
)
#: What computing with values of a wrong type may raise.
_FAILURES = (
    TemplateError,
    ArithmeticError,
    AttributeError,
    LookupError,
    NameError,
    RecursionError,
    SyntaxError,
    TypeError,
    ValueError,
    re.error,
)


class ExpressionError(Exception):
    """What is wrong with an expression, one line; `undefined`: it needs an unknown value."""

    def __init__(self, message: str, *, undefined: bool = False) -> None:
        super().__init__(message)
        self.undefined = undefined


@attrs.frozen
class Reference:
    """A `vars.NAME` or `data.NAME` in an expression; `start` and `end` are its place in it."""

    header: str
    name: str
    start: int
    end: int


def references(source: str, known: Callable[[str, str], bool]) -> Iterator[Reference]:
    """Yield the references of an expression.

    Of `vars.image.split(':')` and `vars.count-1` the longest known name is taken; if none is
    known, the part up to the first dot.
    """
    for match in _REFERENCE.finditer(source):
        if match["quoted"]:
            continue
        header = match["header"]
        if match["item"] is not None:
            yield Reference(header, match["item"], match.start(), match.end())
        else:
            name = _find_longest(header, match["name"], known)
            yield Reference(header, name, match.start(), match.start("name") + len(name))


def _find_longest(header: str, text: str, known: Callable[[str, str], bool]) -> str:
    cuts = [len(text), *(m.start() for m in reversed(list(re.finditer(r"[-!?.]", text))))]
    for cut in cuts:
        if cut and known(header, text[:cut]):
            return text[:cut]
    plain = _UNKNOWN_NAME.match(text)
    return plain[0] if plain else text


def make_undefined(reference: Reference) -> Any:
    """Return a placeholder for an unknown value, which only the filter `default` accepts."""
    return StrictUndefined(name=f"{reference.header}.{reference.name}")


def evaluate(
    source: str, values: Mapping[Reference, Any], limits: AbstractContextManager[None]
) -> Any:
    """Return what the expression gives, as plain data.

    Args:
        limits: limits the time and the memory of what is computed in it.

    Raises:
        ExpressionError: it is not an expression, cannot be computed, or would make too much.
    """
    text, context = _rewrite(source, values)
    try:
        if len(text) > LONGEST_EXPRESSION:
            raise ValueError(f"an expression has at most {LONGEST_EXPRESSION} characters")
        with limits:
            return _data(_compile(text)(**context), source, iter(range(MOST_VALUES)))
    except TemplateSyntaxError as error:
        raise ExpressionError(_syntax(error, source)) from error
    except UndefinedError as error:
        message = f"in {source}: {error.message}{_hint(str(error))}"
        raise ExpressionError(message, undefined=True) from error
    except MemoryError as error:
        raise ExpressionError(f"{source} needs too much memory") from error
    except _FAILURES as error:
        raise ExpressionError(f"in {source}: {error}") from error


def _rewrite(source: str, values: Mapping[Reference, Any]) -> tuple[str, dict[str, Any]]:
    """Return the expression with a name of its own for each reference, and their values."""
    pieces, context, place = [], {}, 0
    for number, (reference, value) in enumerate(values.items()):
        pieces += [source[place : reference.start], f"{_PREFIX}{number}"]
        context[f"{_PREFIX}{number}"] = value
        place = reference.end
    return "".join([*pieces, source[place:]]), context


def _data(value: Any, source: str, room: Iterator[int]) -> Any:
    """Return a result, with all in it that is lazy, as data; `room` has an entry for each value."""
    if next(room, None) is None:
        raise ValueError(f"a result has at most {MOST_VALUES} values")
    if isinstance(value, StrictUndefined):
        value._fail_with_undefined_error()
    if isinstance(value, int) and value.bit_length() > MOST_BITS:
        raise ExpressionError(f"{source} gives a number of more than a thousand digits")
    if isinstance(value, str | int | float) or value is None:
        return value
    if isinstance(value, Mapping):
        return {str(key): _data(item, source, room) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [_data(item, source, room) for item in value]
    raise ExpressionError(f"{source} gives a {type(value).__name__}, which is not data")


def _syntax(error: TemplateSyntaxError, source: str) -> str:
    message = (error.message or "this is not an expression").rstrip(".")
    missing = re.match(r"No (filter|test) named '(\w+)'", message)
    if missing:
        kind, name = missing.groups()
        known = environment().filters if kind == "filter" else environment().tests
        return f'unknown {kind} "{name}"{name_nearest(name, known)}'
    return f"{source} is not an expression: {message}"


def _hint(message: str) -> str:
    unknown = re.match(r"'(\w+)' is undefined", message)
    if unknown and not unknown[1].startswith(_PREFIX):
        return f": write vars.{unknown[1]} or data.{unknown[1]}"
    return ""


@lru_cache(maxsize=512)
def _compile(text: str) -> Callable[..., Any]:
    return environment().compile_expression(text, undefined_to_none=False)


@lru_cache(maxsize=1)
def environment() -> Environment:
    found = ImmutableSandboxedEnvironment(undefined=StrictUndefined, optimized=False)
    found.globals = {"range": found.globals["range"], "dict": dict}
    found.filters = {name: work for name, work in found.filters.items() if name not in LEFT_OUT}
    found.filters["regex_replace"] = _regex_replace
    return found


def _regex_replace(
    value: Any,
    pattern: str,
    replacement: str = "",
    ignorecase: bool = False,  # noqa: FBT001, FBT002 - the filter's users may give it by position
    multiline: bool = False,  # noqa: FBT001, FBT002
    count: int = 0,
) -> str:
    """Ansible's filter of that name, which src.plugin's Rigelfiles use."""
    flags = (re.IGNORECASE if ignorecase else 0) | (re.MULTILINE if multiline else 0)
    return re.sub(pattern, replacement, str(value), count=count, flags=flags)

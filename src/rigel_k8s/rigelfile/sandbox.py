"""jinja2's sandbox with a meter: what an expression may call, and how much it may make.

jinja2 shields Python from an expression, but lets it fill the memory: `"a" * 10**9` is enough.
So each operation is charged for its input and output; operations that multiply are charged before
they run. Regular expressions, whose time no size bounds, have a time limit of their own.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from functools import lru_cache, wraps
from math import prod
from time import monotonic
from typing import Any

import attrs
import regex
from jinja2 import Environment, StrictUndefined
from jinja2.nodes import EvalContext
from jinja2.runtime import Context
from jinja2.sandbox import ImmutableSandboxedEnvironment

from rigel_k8s.rigelfile.limits import LONGEST_EXPRESSION, MOST_WORK, REGEX_SECONDS

#: A whole number of 4,096 bits has 1,234 digits.
MOST_BITS = 4096
#: The largest width or repeat count.
MOST_WIDE = 10_000
#: The cost of compiling one character of an expression, and the cost of one call.
COMPILING, CALLING = 50, 50
#: Filters for HTML, random filters, and filters without a bound.
LEFT_OUT = frozenset(
    ("attr", "e", "escape", "forceescape", "pprint", "random", "safe", "striptags", "urlize")
    + ("wordwrap", "xmlattr")
)
#: The methods of texts, lists, mappings and numbers.
METHODS = frozenset(
    ("capitalize", "casefold", "center", "count", "endswith", "find", "format", "get", "index")
    + ("is_integer", "isalnum", "isalpha", "isascii", "isdecimal", "isdigit", "isidentifier")
    + ("islower", "isnumeric", "isspace", "istitle", "isupper", "items", "join", "keys", "ljust")
    + ("lower", "lstrip", "partition", "removeprefix", "removesuffix", "replace", "rfind", "rindex")
    + ("rjust", "rpartition", "rsplit", "rstrip", "split", "splitlines", "startswith", "strip")
    + ("swapcase", "title", "upper", "values", "zfill")
)
#: Filters and methods whose numeric arguments decide the size of the result.
WIDE = frozenset(
    ("batch", "center", "format", "indent", "ljust", "rjust", "round", "slice", "zfill")
)
#: What jinja2 passes to a filter before its value.
_PASSED = (Environment, Context, EvalContext)
#: A regular expression's characters, and the product of the counts in it: `(a{10}){10}` is 100.
LONGEST_PATTERN = 200
MOST_REPEATED = 10_000
_COUNTS = re.compile(r"\{[^}]*?(\d+)\s*\}")
#: `%99999d`, and `%*d`, whose width is a value.
_WIDE_FORMAT = re.compile(r"\d{5}|%[^a-zA-Z%]*\*")


class Excess(ValueError):
    """An expression that would make or take too much."""


@attrs.define
class Meter:
    """What the expressions of one file may still do.

    Attributes:
        work: characters, and entries of lists, that may still be read or made.
        seconds: for regular expressions.
    """

    work: int = MOST_WORK
    seconds: float = REGEX_SECONDS

    def charge(self, amount: int) -> None:
        """Subtract an amount of work; raise Excess if less is left."""
        self.work -= amount
        if self.work < 0:
            raise Excess("the expressions of this file make more data than is allowed")


_METER: ContextVar[Meter] = ContextVar("meter")


def run(text: str, context: Mapping[str, Any], meter: Meter) -> Any:
    """Return what an expression gives.

    Raises:
        Excess: it makes too much.
        Exception: any error of jinja2 or of the calculation.
    """
    if len(text) > LONGEST_EXPRESSION:
        raise Excess(f"an expression has at most {LONGEST_EXPRESSION} characters")
    token = _METER.set(meter)
    try:
        meter.charge(sum(map(weigh, context.values())))
        return materialise(_compile(text)(**context))
    finally:
        _METER.reset(token)


def materialise(value: Any) -> Any:
    """Return a lazy result as a list, and those in it, while the meter runs."""
    if isinstance(value, str | int | float | StrictUndefined) or value is None:
        return value
    if isinstance(value, Mapping):
        return {key: materialise(item) for key, item in value.items()}
    if isinstance(value, Iterable):
        items = []
        for item in value:
            _METER.get().charge(1)
            items.append(materialise(item))
        return items
    return value


@lru_cache(maxsize=512)
def _compile(text: str) -> Callable[..., Any]:
    _METER.get().charge(COMPILING * len(text))
    return environment().compile_expression(text, undefined_to_none=False)


@lru_cache(maxsize=1)
def environment() -> Environment:
    """Return the environment of all expressions; the meter of each is in its context."""
    found = _Sandbox(undefined=StrictUndefined, optimized=False)
    found.globals = {"range": found.globals["range"], "dict": dict}
    found.filters["regex_replace"] = _regex_replace
    found.filters = {
        name: _metered(name, work) for name, work in found.filters.items() if name not in LEFT_OUT
    }
    found.tests = {name: _metered(name, work) for name, work in found.tests.items()}
    return found


class _Sandbox(ImmutableSandboxedEnvironment):
    intercepted_binops = frozenset(("+", "-", "*", "/", "//", "%", "**"))

    def call_binop(self, context: Context, operator: str, left: Any, right: Any) -> Any:
        """Compute, after checking that the result stays small."""
        meter = _METER.get()
        if operator in ("*", "**"):
            _check_product(operator, left, right)
        if operator == "*":
            meter.charge(_count(left) * weigh(right) + _count(right) * weigh(left))
        if operator == "%" and isinstance(left, str):
            _check_format(left, [right])
        result = super().call_binop(context, operator, left, right)
        meter.charge(weigh(result))
        return result

    def call(__self, __context: Context, __obj: Any, *args: Any, **kwargs: Any) -> Any:
        """Call a method of plain data, or `range` and `dict`."""
        method = inspect.unwrap(__obj) if callable(__obj) else __obj
        owner = getattr(method, "__self__", None)
        name = str(getattr(method, "__name__", ""))
        if isinstance(owner, str | list | tuple | dict | int | float):
            if name not in METHODS:
                raise Excess(f"the method {name} is not allowed here")
            _check_work(name, (owner, *args), kwargs)
        result = super().call(__context, __obj, *args, **kwargs)
        _METER.get().charge(weigh(result))
        return result


def _metered(name: str, work: Any) -> Callable[..., Any]:
    """Return a filter or test that is charged for its arguments and its result."""

    @wraps(work)
    def metered(*args: Any, **kwargs: Any) -> Any:
        values = [value for value in args if not isinstance(value, _PASSED)]
        if name == "join" and values and not isinstance(values[0], str):
            listed = materialise(values[0])
            args = tuple(listed if value is values[0] else value for value in args)
            values[0] = listed
        _check_work(name, tuple(values), kwargs)
        result = work(*args, **kwargs)
        _METER.get().charge(weigh(result))
        return result

    return metered


def _check_work(name: str, values: tuple[Any, ...], named: Mapping[str, Any]) -> None:
    """Charge a filter, test or method for what it reads, and for what it may multiply."""
    meter = _METER.get()
    given = [*values[1:], *named.values()]
    meter.charge(CALLING + weigh(list(values)) + weigh(dict(named)))
    if name in WIDE and any(_is_number(value) and abs(value) > MOST_WIDE for value in given):
        raise Excess(f"{name} takes numbers up to {MOST_WIDE}")
    value = values[0] if values else None
    longest = max((len(one) for one in given if isinstance(one, str)), default=0)
    if name == "replace" and given:
        old = str(given[0])
        meter.charge((str(value).count(old) if old else len(str(value)) + 1) * longest)
    elif name == "join":
        parts = given[0] if isinstance(value, str) and given else value
        meter.charge(_count(parts) * (longest + (len(value) if isinstance(value, str) else 0)))
    elif name == "indent":
        width = max((int(one) for one in given if _is_number(one)), default=4)
        meter.charge((str(value).count("\n") + 1) * (width + longest))
    elif name == "format":
        _check_format(str(value), given)
    elif name == "sum" and any(isinstance(one, list | tuple) for one in given):
        raise Excess("sum adds only numbers")


def _check_format(text: str, values: list[Any]) -> None:
    """Charge a format string; each value may occur in it many times."""
    if _WIDE_FORMAT.search(text):
        raise Excess("a width in a format has at most four digits")
    largest = max(map(weigh, values), default=0)
    _METER.get().charge(len(text) + (len(text) // 2 + 1) * largest)


def _check_product(operator: str, left: Any, right: Any) -> None:
    """Refuse numbers that would become too long."""
    if not isinstance(left, int) or not isinstance(right, int):
        return
    bits = left.bit_length()
    longest = bits * right if operator == "**" else bits + right.bit_length()
    if longest > MOST_BITS and abs(left) > 1:
        raise Excess("a number of more than a thousand digits")


def weigh(value: Any) -> int:
    """Return the size of a value: characters, entries, and everything inside them."""
    return _weigh(value, {})


def _weigh(value: Any, known: dict[int, int]) -> int:
    if isinstance(value, str):
        return len(value)
    if isinstance(value, int):
        return 1 + value.bit_length() // 8
    if not isinstance(value, Mapping | list | tuple | set):
        return 1
    if id(value) not in known:
        known[id(value)] = 1
        parts = [*value.keys(), *value.values()] if isinstance(value, Mapping) else value
        known[id(value)] = 1 + sum(1 + _weigh(part, known) for part in parts)
    return known[id(value)]


def _count(value: Any) -> int:
    """Return how often a number repeats the other operand, or the length of a list."""
    if isinstance(value, int):
        return max(value, 0)
    return len(value) if isinstance(value, str | list | tuple | Mapping | set | range) else 0


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _regex_replace(
    value: Any,
    pattern: str,
    replacement: str = "",
    ignorecase: bool = False,  # noqa: FBT001, FBT002 - the filter's users may give it by position
    multiline: bool = False,  # noqa: FBT001, FBT002
    count: int = 0,
) -> str:
    """Ansible's filter of that name, which src.plugin's Rigelfiles use."""
    meter = _METER.get()
    flags = (regex.IGNORECASE if ignorecase else 0) | (regex.MULTILINE if multiline else 0)

    def expand(match: Any) -> str:
        longest = max(len(group or "") for group in (match[0], *match.groups()))
        meter.charge(1 + len(replacement) + len(replacement) // 2 * longest)
        return str(match.expand(replacement))

    counts = [int(text[:6]) for text in _COUNTS.findall(pattern)]
    if len(pattern) > LONGEST_PATTERN or prod(counts) > MOST_REPEATED:
        raise Excess(f"the regular expression {pattern} is too long, or repeats too often")
    began = monotonic()
    try:
        found = regex.compile(pattern, flags)
        return str(found.sub(expand, str(value), count=count, timeout=max(meter.seconds, 0.001)))
    except TimeoutError as error:
        raise Excess(f"the regular expression {pattern} takes too long") from error
    finally:
        meter.seconds -= monotonic() - began

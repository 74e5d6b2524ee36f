"""Whether a class is a job type or a provider; reported when it is resolved, not when it runs.

The error names the class, the method and the signature it should have.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.jobs.names import Kind

METHODS: Mapping[Kind, Mapping[str, tuple[str, ...]]] = {
    "job": {"check": ("options", "application"), "run": ("options", "job")},
    "provider": {
        "check": ("options", "application"),
        "connect": ("options", "name", "report"),
        "disconnect": ("connection",),
    },
}

OPTIONAL: Mapping[Kind, Mapping[str, tuple[str, ...]]] = {
    "job": {
        "exclusive": ("options", "application", "settings"),
        "check_files": ("options", "application", "home"),
        "check_jobs": ("options", "jobs"),
        "parts": ("options", "job", "cluster"),
        "release": ("options", "settings", "cluster"),
        "workloads": ("options", "application"),
    },
    "provider": {},
}


def looks_like(cls: type[Any], kind: Kind) -> bool:
    """Return whether the class is meant as ours: it has `options` or the method that works."""
    return hasattr(cls, "options") or (kind == "job" and hasattr(cls, "run"))


def validate(cls: type[Any], kind: Kind, name: str) -> None:
    """Raise a UserError that lists everything that does not fit in the class."""
    faults = [*_options_faults(cls), *_method_faults(cls, kind), *_constructor_faults(cls)]
    if faults:
        raise UserError(
            f"{name} is not a {word(kind)}: {faults[0]}",
            hint=_describe_interface(kind),
            details=faults[1:],
        )


def word(kind: Kind) -> str:
    """Return the kind's name for users."""
    return "job type" if kind == "job" else "provider"


def _describe_interface(kind: Kind) -> str:
    methods = " and ".join(_signature(*one) for one in METHODS[kind].items())
    return f"a {word(kind)} needs `options`, {methods}, and a constructor without arguments"


def _options_faults(cls: type[Any]) -> Iterator[str]:
    options = getattr(cls, "options", None)
    if options is None:
        yield "it has no `options`, the attrs class of what `with` may hold (or dict)"
    elif not (isinstance(options, type) and (attrs.has(options) or options is dict)):
        yield f"its `options` is {options!r}, not an attrs class (or dict)"


def _method_faults(cls: type[Any], kind: Kind) -> Iterator[str]:
    for method, parameters in METHODS[kind].items():
        if not callable(getattr(cls, method, None)):
            yield f"it has no method {_signature(method, parameters)}"
        else:
            yield from _find_misfit(cls, method, parameters)
    for method, parameters in OPTIONAL[kind].items():
        if hasattr(cls, method):
            yield from _find_misfit(cls, method, parameters)


def _find_misfit(cls: type[Any], method: str, parameters: tuple[str, ...]) -> Iterator[str]:
    """Yield a fault if the method, called on an instance, does not take these parameters."""
    static = isinstance(inspect.getattr_static(cls, method), staticmethod | classmethod)
    function = getattr(cls, method)
    try:
        signature = inspect.signature(function)
    except ValueError:  # written in C: its signature is unknown
        return
    try:
        signature.bind(*(() if static else (None,)), *parameters)
    except TypeError:
        yield f"method {method}{signature} must be {_signature(method, parameters)}"


def _constructor_faults(cls: type[Any]) -> Iterator[str]:
    try:
        inspect.signature(cls).bind()
    except TypeError:
        yield f"its constructor {cls.__name__}{inspect.signature(cls)} must not need arguments"
    except ValueError:  # written in C: its signature is unknown
        return


def _signature(method: str, parameters: tuple[str, ...]) -> str:
    return f"{method}({', '.join(('self', *parameters))})"

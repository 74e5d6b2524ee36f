"""What does not fit Kubernetes' own description of its objects: unknown fields, other types; pure.

fields.txt is that description, which tools/kubefields.py makes; a type is read when it is needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

import attrs

from rigel_k8s.objects.overlay import IDENTITIES, WHOLE, WHOLE_ITEMS
from rigel_k8s.option_text import has_template, text_of
from rigel_k8s.problems import Path, Problem
from rigel_k8s.rigelfile import find_nearest

#: Scalars: the types of Python that YAML makes of them, and what messages call them.
SCALARS: Mapping[str, tuple[tuple[type, ...], str]] = {
    "s": ((str,), "text"),
    "i": ((int,), "a whole number"),
    "b": ((bool,), "true or false"),
    "q": ((str, int, float), "a quantity"),
    "n": ((str, int), "a number or text"),
}
#: What messages call values, by the first type that fits; a bool is an int, too.
NAMES: Mapping[type, str] = {
    type(None): "empty",
    bool: "true or false",
    str: "text",
    int: "a number",
    float: "a number",
    Mapping: "a mapping",
}
#: The type of pods: their fields are often written above.
POD, BELOW = "PodSpec", "spec.template.spec"


@cache
def read_types() -> Mapping[str, str]:
    """Return the version of Kubernetes, as "#", and the fields of each type as a text."""
    lines = files(__package__).joinpath("fields.txt").read_text("utf-8").splitlines()
    version = lines[0].partition(";")[0].rpartition(" ")[2]
    return {"#": version, **{n: f for n, _, f in (line.partition(" ") for line in lines[1:])}}


@cache
def fields_of(name: str) -> Mapping[str, str]:
    """Return the fields of a type, each with its type; a required one ends with "!"."""
    pairs = (field.partition(":") for field in read_types()[name].split())
    return {key.rstrip("!"): kind + key[len(key.rstrip("!")) :] for key, _, kind in pairs}


@attrs.frozen
class Place:
    """Where a value is.

    Attributes:
        path: in the options; what messages call the outermost value.
        field: below that.
        whole: it replaces what `rigel` generates, so nothing that Kubernetes requires is there.
    """

    path: Path
    title: str
    field: Path = ()
    whole: bool = False

    def below(self, key: str | int, *, whole: bool = False) -> Place:
        return attrs.evolve(self, field=(*self.field, key), whole=self.whole or whole)

    def problem(self, text: str, kind: str, *, at_key: bool = False) -> Problem:
        return Problem((*self.path, *self.field), text, kind, at_key=at_key)


def check_value(value: Any, kind: str, place: Place) -> Iterator[Problem]:
    """Yield what is wrong with a value of a type of Kubernetes; null removes a field."""
    if kind.startswith("{"):
        if not isinstance(value, Mapping):
            yield wrong_type(value, "a mapping", place)
            return
        for key, part in value.items():
            if part is not None:
                yield from check_value(part, kind[1:-1], place.below(str(key)))
    elif kind.startswith("["):
        yield from check_list(value, kind[1:-1], place)
    elif kind in SCALARS:
        yield from check_scalar(value, kind, place)
    elif kind != "*":
        yield from check_fields(value, kind, place)


def check_scalar(value: Any, kind: str, place: Place) -> Iterator[Problem]:
    """Yield a scalar of another type, as the API server does not convert it."""
    types, expected = SCALARS[kind]
    fits = isinstance(value, types) and (not isinstance(value, bool) or kind == "b")
    if fits or (isinstance(value, str) and has_template(value)):
        return
    if kind == "s" and isinstance(value, bool | int | float):
        hint = f': write "{text_of(value)}" in quotes'
        yield place.problem(f"{show(place)} must be text{hint}", "wrong-type")
    else:
        written = {"b": ("true", "false"), "i": (str(value) if str(value).isdecimal() else "",)}
        quoted = isinstance(value, str) and value and value in written.get(kind, ())
        found = wrong_type(value, expected, place)
        hint = ": remove the quotes" if quoted else ""
        yield attrs.evolve(found, message=f"{found.message}{hint}")


def check_list(value: Any, kind: str, place: Place) -> Iterator[Problem]:
    if not isinstance(value, list | tuple):
        yield wrong_type(value, "a list", place)
        return
    name = str(place.field[-1])
    # Items that have an identity are laid over those that have the same.
    whole = name in WHOLE_ITEMS or name not in IDENTITIES
    for index, item in enumerate(value):
        yield from check_value(item, kind, place.below(index, whole=whole))
        identity = IDENTITIES.get(name)
        if identity and isinstance(item, Mapping) and not whole and item.get(identity) is None:
            yield missing(identity, place.below(index))


def check_fields(value: Any, kind: str, place: Place) -> Iterator[Problem]:
    """Yield what is wrong with an object."""
    if not isinstance(value, Mapping):
        yield wrong_type(value, "a mapping", place)
        return
    known = fields_of(kind)
    for key, part in ((str(key), part) for key, part in value.items()):
        here = place.below(key, whole=key in WHOLE)
        if key not in known:
            yield unknown(key, known, here)
        elif part is not None:
            yield from check_value(part, known[key].rstrip("!"), here)
    for key, of in known.items():
        if place.whole and of.endswith("!") and value.get(key) is None:
            yield missing(key, place)


def unknown(key: str, known: Mapping[str, str], place: Place) -> Problem:
    """Return the problem of a field that Kubernetes does not have; a newer one may have it."""
    text = ""
    if key in fields_of(POD) and ("template" in known or "spec" in known):
        text = f"{key} is a field of the pod: write it below {BELOW}"
    elif near := find_nearest(key, known):
        text = f'unknown field "{key}", did you mean "{near}"?'
    if text:
        return place.problem(text, "unknown-key", at_key=True)
    text = f'Kubernetes {read_types()["#"]} has no field "{key}" here, and refuses unknown ones'
    found = place.problem(text, "unknown-key", at_key=True)
    return attrs.evolve(found, severity="warning")


def missing(key: str, place: Place) -> Problem:
    """Return the problem of a field that is required and missing."""
    return place.problem(f"{show(place)} needs `{key}`", "incomplete")


def wrong_type(value: object, expected: str, place: Place) -> Problem:
    """Return the problem of a value of a type that Kubernetes refuses there."""
    got = next((name for of, name in NAMES.items() if isinstance(value, of)), "a list")
    return place.problem(f"{show(place)} must be {expected}, not {got}", "wrong-type")


def show(place: Place) -> str:
    """Return a field as people write it: spec.template.spec.containers[0].env of a Deployment."""
    parts = (f"[{key}]" if isinstance(key, int) else f".{key}" for key in place.field)
    text = "".join(parts).lstrip(".")
    return f"{text} of {place.title}" if text else place.title

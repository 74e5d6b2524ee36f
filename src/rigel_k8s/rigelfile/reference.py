"""The options of job types and providers as Markdown, made from the classes that a check uses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.rigelfile.fields import (
    Field,
    describe_type,
    fields_of,
    members,
    nesting_key,
    summary,
    type_arguments,
    unwrap,
)

HEAD = """# Reference

Every option of the job types and providers of this package. This page is made from the code.
"""


def reference(jobs: Mapping[tuple[str, ...], Any], providers: Mapping[tuple[str, ...], Any]) -> str:
    """Return the Markdown page of option classes, each given under all its names."""
    sections = [HEAD]
    for title, types in (("Jobs", jobs), ("Providers", providers)):
        sections.append(f"## {title}\n")
        sections += [text for names, cls in types.items() for text in _component(names, cls)]
    return "\n".join(sections)


def _component(names: tuple[str, ...], cls: Any) -> Iterator[str]:
    yield f"### {names[0]}\n"
    yield f"`plugin` or `provider` is one of {', '.join(f'`{name}`' for name in names)}.\n"
    if not attrs.has(cls):
        yield "Any keys.\n"
        return
    under = nesting_key(cls)
    if under:
        yield f"The keys stand directly in `with`, or below `{under}` in it.\n"
    yield _table(cls)
    for path, inner in _find_inner(cls, "", {cls}):
        yield f"#### {names[0]}: `{path}`\n"
        yield _table(inner)


def _find_inner(
    cls: type[Any], prefix: str, seen: set[type[Any]]
) -> Iterator[tuple[str, type[Any]]]:
    """Yield the classes of values below a class, each once, with the path to the first use."""
    for field in fields_of(cls):
        for path, kind in _classes(field.type, f"{prefix}{field.key}"):
            if kind not in seen:
                seen.add(kind)
                yield path, kind
                yield from _find_inner(kind, f"{path}.", seen)


def _classes(kind: Any, path: str) -> Iterator[tuple[str, type[Any]]]:
    for member in members(unwrap(kind)):
        arguments = type_arguments(member)
        if isinstance(member, type) and attrs.has(member):
            yield path, member
        elif arguments:
            step = ".NAME" if len(arguments) == 2 else "[]"
            yield from _classes(arguments[-1], f"{path}{step}")


def _table(cls: type[Any]) -> str:
    rows = ["| key | value | default | |", "|---|---|---|---|", *map(_row, fields_of(cls))]
    text = summary(cls)
    return "\n".join([*([f"{text}\n"] if text else []), *rows, ""])


def _row(field: Field) -> str:
    names = " or ".join(f"`{key}`" for key in field.keys)
    cells = [names, describe_type(field.type), _default(field), field.doc]
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def _default(field: Field) -> str:
    if field.required:
        return "required"
    value = field.default
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str | int | float) and value != "":
        return f"`{value}`"
    if isinstance(value, tuple | list) and value:
        return f"`[{', '.join(map(str, value))}]`"
    return ""

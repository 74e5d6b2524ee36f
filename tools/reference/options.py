"""The options of job types and providers as Markdown, generated from their classes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.commands.rigelfiles import list_option_classes
from rigel_k8s.rigelfile.expansion import list_added_fields
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

HEAD = """# Options

All options of the job types and providers of this package. This page is generated from the code.
Examples are on the pages of the tasks: [nodes](nodes.md), [machines, devices and
volumes](placement.md), [networks](networking.md), [security](security.md), [images](images.md),
[the stack](observability.md), [Eclipse Muto](muto.md).
"""
#: Where the name of a type ends and its explanation begins.
EXPLANATION = re.compile(r"(?=: | such as | \()")


def write_options() -> str:
    """Return the page of our job types and providers, each with all its names."""
    jobs, providers = list_option_classes("job"), list_option_classes("provider")
    types = name_types([*jobs.values(), *providers.values()])
    sections = [HEAD]
    for title, components in (("Jobs", jobs), ("Providers", providers)):
        sections.append(f"## {title}\n")
        for names, cls in components.items():
            sections += _component(names, cls, types)
    sections.append("## Values\n")
    sections += [f"- **{name}**{text[len(name) :]}" for text, name in sorted(types.items())]
    return "\n".join([*sections, ""])


def name_types(classes: Iterable[Any]) -> dict[str, str]:
    """Return the names of types by their descriptions: of those that are explained once, below.

    They are used more than once, and no other type has their name.
    """
    options = [cls for cls in classes if attrs.has(cls)]
    options += [inner for cls in options for _, inner in _find_inner(cls, "", {cls})]
    uses = Counter(describe_type(field.type) for cls in options for field in _fields(cls))
    names = {text: EXPLANATION.split(text, maxsplit=1)[0] for text in uses}
    types = Counter(names.values())
    return {
        text: name
        for text, name in names.items()
        if uses[text] > 1 and types[name] == 1 and name != text and "one of " not in text
    }


def _fields(cls: Any) -> tuple[Field, ...]:
    return (*fields_of(cls), *list_added_fields(cls))


def _component(names: tuple[str, ...], cls: Any, types: Mapping[str, str]) -> Iterator[str]:
    yield f"### {names[0]}\n"
    yield f"`plugin` or `provider` is one of {', '.join(f'`{name}`' for name in names)}.\n"
    if not attrs.has(cls):
        yield "Any keys.\n"
        return
    under = nesting_key(cls)
    if under:
        yield f"The keys are directly in `with`, or in `{under}` below it.\n"
    sections = {inner: f"{names[0]}: `{path}`" for path, inner in _find_inner(cls, "", {cls})}
    yield _table(cls, types, sections)
    for inner, title in sections.items():
        yield f"#### {title}\n"
        yield _table(inner, types, sections)


def _find_inner(
    cls: type[Any], prefix: str, seen: set[type[Any]]
) -> Iterator[tuple[str, type[Any]]]:
    """Yield the classes of values below a class, each once, with the path to the first use."""
    for field in _fields(cls):
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


def _table(cls: type[Any], types: Mapping[str, str], sections: Mapping[type[Any], str]) -> str:
    head = ["| key | value | default | meaning |", "|---|---|---|---|"]
    rows = [*head, *(_row(field, types, sections) for field in _fields(cls))]
    text = summary(cls)
    return "\n".join([*([f"{text}\n"] if text else []), *rows, ""])


def _row(field: Field, types: Mapping[str, str], sections: Mapping[type[Any], str]) -> str:
    names = " or ".join(f"`{key}`" for key in field.keys)
    value = describe_type(field.type)
    if value in types:
        value = f"[{types[value]}](#values)"
    for _, inner in _classes(field.type, ""):
        anchor = re.sub(r"[^\w -]", "", sections[inner].lower()).replace(" ", "-")
        value = re.sub(r"^a (mapping|list)", rf"[\g<0>](#{anchor})", value)
    cells = [names, value, _default(field), field.doc]
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

"""Values of parameters, and where they stand among the options of a node or a job."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_import.draft import Place
from rigel_k8s.errors import UserError
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import Source, strip_places

Options = dict[str, Any]


def put(options: Options, key: str, name: str, value: Any) -> None:
    """Set an entry of an option that is a mapping; a mapping is merged into one of its name."""
    entries = options.setdefault(key, {})
    entries[name] = merge(entries.get(name), value)


def merge(base: Any, more: Any) -> Any:
    """Return a mapping over another one, level by level; of other values the second one."""
    if not isinstance(base, Mapping) or not isinstance(more, Mapping):
        return more
    return {**base, **{key: merge(base.get(key), value) for key, value in more.items()}}


def read_typed(text: str, kind: str, place: Place) -> Any:
    """Return the `value` of a roslaunch parameter with its `type`, by default "auto".

    A text that a container completes stays a text: the container gives it a type.
    """
    if "$(" in text or kind in ("str", "string"):
        return text
    if kind == "yaml":
        return read_yaml(text, place)
    value = as_number(text)
    return float(value) if kind == "double" and isinstance(value, int) else value


def as_number(text: str) -> Any:
    """Return a text as roslaunch does: as a number or boolean if it looks like one."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text.lower() == "true" if text.lower() in ("true", "false") else text


def read_yaml(text: str, place: Place) -> Any:
    """Return YAML as plain data; dates are texts. Raises UserError if it is invalid."""
    if not text.strip():
        return None
    content, findings = parse(Source(str(place), text))
    if findings:
        message = f"{place}: invalid YAML: {findings[0].message}"
        raise UserError(message, hint="correct the value")
    return strip_places(content) if content else None

"""Payloads as values: JSON that is read strictly, and topics that an answer may go to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from rigel_muto.agent.commands import Refusal

#: Bytes of a payload. Kubernetes stores no larger objects, so no larger stack could be deployed.
MOST_BYTES = 2**20
#: Bytes of a topic, by MQTT.
LONGEST_TOPIC = 65535
#: Characters of a value that an error shows.
SHOWN = 100


class Malformed(Exception):
    """A message that cannot be used; the refusal has the reason."""

    def __init__(self, message: str, kind: str = "malformed") -> None:
        super().__init__(message)
        self.refusal = Refusal(kind, message)


def read_json(payload: bytes, what: str = "the payload") -> Any:
    """Return the value of a payload, which must be JSON that all readers understand alike.

    Raises:
        Malformed: it is not, or it is too large.
    """
    if len(payload) > MOST_BYTES:
        raise Malformed(f"{what} has more than {MOST_BYTES} bytes", "too-large")
    try:
        value = json.loads(
            payload.decode("utf-8"),
            object_pairs_hook=_refuse_duplicates,
            parse_constant=_refuse_constant,
        )
        write_json(value)  # 1e999 is read as infinity, which JSON does not have
    except (ValueError, RecursionError) as error:
        raise Malformed(f"{what} is not JSON: {error}") from error
    return value


def _refuse_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        raise ValueError("an object has the same key twice")
    return result


def _refuse_constant(text: str) -> Any:
    raise ValueError(f"{text} is not a number")


def read_object(payload: bytes, what: str = "the payload") -> Mapping[str, Any]:
    """Return the object that a payload is; an empty payload is an empty one. Raises Malformed."""
    return check_object(read_json(payload, what) if payload.strip() else None, what)


def check_object(value: Any, what: str) -> Mapping[str, Any]:
    """Return a value that must be an object; null is an empty one. Raises Malformed."""
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise Malformed(f"{what} must be an object, got {_shorten(value)}")
    return value


def object_at(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return the object of a key, empty without the key. Raises Malformed."""
    return check_object(content.get(key), f'"{key}"')


def text_at(content: Mapping[str, Any], key: str) -> str:
    """Return the text of a key, "" without the key. Raises Malformed for another type."""
    value = content.get(key)
    if value is None:
        return ""
    if not isinstance(value, str):
        raise Malformed(f'"{key}" must be text, got {_shorten(value)}')
    if not _is_encodable(value):
        raise Malformed(f'"{key}" has half a character in it: {_shorten(value)}')
    return value


def flag_at(content: Mapping[str, Any], key: str, *, default: bool) -> bool:
    """Return the truth of a key, also as the text that headers have. Raises Malformed."""
    value = content.get(key)
    if value is None:
        return default
    if isinstance(value, bool):
        return value
    if value == "true" or value == "false":
        return bool(value == "true")
    raise Malformed(f'"{key}" must be true or false, got {_shorten(value)}')


def write_json(value: Any) -> str:
    return json.dumps(value, allow_nan=False)


def is_topic(text: str) -> bool:
    """Return whether an answer can be sent there: no wildcards, and not one of the broker's own."""
    if not _is_encodable(text) or text.startswith("$") or set(text) & set("+#\0"):
        return False
    return 0 < len(text.encode("utf-8")) <= LONGEST_TOPIC


def _is_encodable(text: str) -> bool:
    """Return whether a text is Unicode: JSON's escapes can also name half a character."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def _shorten(value: Any) -> str:
    text = write_json(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."

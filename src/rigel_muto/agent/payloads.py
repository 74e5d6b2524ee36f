"""Payloads as commands and queries: what all three protocols have in common.

A payload is JSON that is read strictly, so that all readers understand it alike.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, get_args

from rigel_k8s.rigelfile.source import Source, Span, YamlNode
from rigel_muto.agent.commands import Command, Deploy, Kill, Query, QueryKind, Refusal
from rigel_muto.formats import list_stacks
from rigel_muto.reading import decode, read
from rigel_muto.remarks import Unreadable
from rigel_muto.stack import DESCRIPTIONS

#: Bytes of a payload. Kubernetes stores no larger objects, so no larger stack could be deployed.
MOST_BYTES = 2**20
#: Bytes of a topic, by MQTT.
LONGEST_TOPIC = 65535
#: Characters of a value that an error shows.
SHOWN = 100
#: What a query must name.
NEEDED = {
    "ros/node/info": "node",
    "ros/topic/info": "topic",
    "ros/topic/echo": "topic",
    "ros/param/get": "param",
}


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


def identify(correlation: str, topic: str, payload: bytes) -> str:
    """Return what identifies a message, "" if its sender gave no correlation.

    The message itself is part of it, because some senders use one correlation for all of theirs.
    """
    if not correlation:
        return ""
    content = hashlib.sha256(topic.encode("utf-8") + b"\0" + payload).hexdigest()
    return f"{correlation}:{content[:16]}"


def read_command(method: str, content: Mapping[str, Any], identity: str) -> Command:
    """Return the command that the method of a stack is.

    Args:
        content: a stack, or an object that names one by `stackId`.

    Raises:
        Malformed: the method is unknown, or the stack is missing.
    """
    if method == "kill":
        return Kill(identity=identity, stack_id=text_at(content, "stackId"))
    if method not in ("start", "apply"):
        message = f'unknown command "{method}" for a stack: expected start, apply or kill'
        raise Malformed(message, "unknown-command")
    stack_id = text_at(content, "stackId")
    if stack_id and _says_nothing_else(content):
        return Deploy(identity=identity, stack_id=stack_id)
    if not content:
        message = "the message is empty and so not a stack: send a stack, or its `stackId`"
        raise Malformed(message, "not-a-stack")
    text = write_json(content)
    ids = (stack_id, *_list_ids(text))
    return Deploy(identity=identity, stack=text, stack_id=next(filter(None, ids), ""))


def _says_nothing_else(content: Mapping[str, Any]) -> bool:
    """Return whether an object describes a stack without being one; Muto writes empty sections."""
    said = {key for key, value in content.items() if value not in (None, "", [], {})}
    return said <= set(DESCRIPTIONS)


def read_component(component: Mapping[str, Any]) -> str:
    """Return the text of the stack that a component of Symphony is.

    Args:
        component: has a name, and `stack` as its type.

    Raises:
        Malformed: it is not a stack.
    """
    data = object_at(component, "properties").get("data")
    if not isinstance(data, str | dict):
        message = f'the data of the component "{component["name"]}" must be base64 or an object'
        raise Malformed(message, "not-a-stack")
    _list_ids(write_json({"spec": {"components": [component]}}))
    if isinstance(data, dict):
        return write_json(data)
    return decode(YamlNode(data, Span(1, 1, 1, 1)), "component").text


def _list_ids(text: str) -> tuple[str, ...]:
    """Return the ids of the one stack in a text. Raises Malformed unless it is exactly one."""
    try:
        stacks = list_stacks(read(Source("the message", text)))
    except Unreadable as error:
        raise Malformed(str(error), "not-a-stack") from error
    if len(stacks) > 1:
        raise Malformed("there are several stacks in this message: send one", "not-a-stack")
    if stacks[0].needs_build:
        message = "this is an archive with sources, which needs a build: see `rigel muto convert`"
        raise Malformed(message, "not-a-stack")
    return stacks[0].ids


def read_query(kind: str, arguments: Mapping[str, Any]) -> Query:
    """Return a question about the ROS graph. Raises Malformed for an unknown or incomplete one."""
    known: dict[str, QueryKind] = {name: name for name in get_args(QueryKind)}
    if kind not in known:
        raise Malformed(f'unknown command "{kind}" for the agent', "unknown-command")
    needed = NEEDED.get(kind)
    if needed and not text_at(arguments, needed):
        raise Malformed(f'{kind} needs "{needed}"')
    return Query(known[kind], arguments)

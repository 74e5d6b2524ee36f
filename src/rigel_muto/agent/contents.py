"""Values of payloads as commands and queries: what all three protocols have in common."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, get_args

from rigel_k8s.rigelfile.source import Source, Span, YamlNode
from rigel_muto.agent.commands import Command, Deploy, Kill, Query, QueryKind
from rigel_muto.agent.payloads import Malformed, object_at, text_at, write_json
from rigel_muto.formats import list_stacks
from rigel_muto.reading import decode, read
from rigel_muto.remarks import Unreadable
from rigel_muto.stack import DESCRIPTIONS

#: What a query must name.
NEEDED = {
    "ros/node/info": "node",
    "ros/topic/info": "topic",
    "ros/topic/echo": "topic",
    "ros/param/get": "param",
}
_NAME = "the message"


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
        stacks = list_stacks(read(Source(_NAME, text)))
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

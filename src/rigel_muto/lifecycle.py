"""The transitions of a lifecycle node of a stack."""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.option_text import text_of
from rigel_k8s.rigelfile.findings import suggest
from rigel_k8s.rigelfile.source import YamlNode, kind_of
from rigel_muto.remarks import Remark, Unreadable, describe_unknown, error, loss
from rigel_muto.stack import is_empty

TIMES = ("start", "stop")
TRANSITIONS = ("configure", "activate", "deactivate", "cleanup", "shutdown")


def read_lifecycle(section: YamlNode) -> YamlNode:
    """Return the option `lifecycle`. Raises Unreadable if it has something else in a list."""
    if not isinstance(section.value, dict):
        message = f'"lifecycle" must be a mapping, got {kind_of(section.value)}'
        raise Unreadable(error(section, message, "wrong-type"))
    found = {
        time: attrs.evolve(section.value[time], value=list(list_transitions(section.value[time])))
        for time in TIMES
        if time in section.value and not is_empty(section.value[time])
    }
    return attrs.evolve(section, value=found)


def list_transitions(value: YamlNode) -> Iterator[YamlNode]:
    """Yield the transitions of a list; a text is a list of one."""
    for entry in value.value if isinstance(value.value, list) else [value]:
        if isinstance(entry.value, dict | list) or text_of(entry.value) not in TRANSITIONS:
            what = f'"{entry.value}"' if isinstance(entry.value, str) else kind_of(entry.value)
            close = suggest(str(entry.value), TRANSITIONS)
            message = f"{what} is not a transition of a lifecycle node{close}"
            raise Unreadable(error(entry, message, "unknown-transition"))
        yield entry


def list_losses(section: YamlNode, node: str) -> Iterator[Remark]:
    """Yield the parts of a node's `lifecycle` that have no counterpart."""
    for key, value in section.value.items():
        if key not in TIMES and not is_empty(value):
            yield loss(value, describe_unknown(key, "a lifecycle", TIMES), node=node)

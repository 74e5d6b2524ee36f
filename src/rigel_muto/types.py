"""What a text of a stack means as the value of a parameter."""

from __future__ import annotations

import re
from typing import Any

from rigel_k8s.rigelfile.limits import LONGEST_NUMBER
from rigel_k8s.rigelfile.source import YamlNode, node_of

_WHOLE_NUMBER = re.compile(r"[-+]?\d+")
_NUMBER = re.compile(r"[-+]?(\d+\.\d*|\.\d+|\d+(?=[eE]))([eE][-+]?\d+)?")
_TRUTHS = {"true": True, "false": False}


def give_type(node: YamlNode) -> YamlNode:
    """Return a text that is written as a number or boolean as one: "2" is 2; others unchanged."""
    text: Any = node.value
    if not isinstance(text, str):
        return node
    if text.lower() in _TRUTHS:
        return node_of(_TRUTHS[text.lower()], node)
    if len(text) > LONGEST_NUMBER:
        return node
    if _WHOLE_NUMBER.fullmatch(text):
        return node_of(int(text), node)
    return node_of(float(text), node) if _NUMBER.fullmatch(text) else node

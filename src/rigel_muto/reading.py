"""Text of stacks to values with places. JSON is YAML, except for the forms of its numbers."""

from __future__ import annotations

import base64
import binascii
import json
import re
import zlib

import attrs

from rigel_k8s.rigelfile.limits import MOST_BYTES
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import Source, Span, YamlNode, kind_of
from rigel_muto.remarks import Remark, Unreadable, error

_JSON_NUMBER = re.compile(r"-?(0|[1-9]\d*)(\.\d+)?([eE][+-]?\d+)?")
#: Two escapes that JSON writes for one character beyond 16 bits; YAML has one for it.
_PAIR = re.compile(
    r"(?<!\\)((?:\\\\)*)\\u(d[89ab][0-9a-f]{2})\\u(d[c-f][0-9a-f]{2})", re.IGNORECASE
)
_GZIP = b"\x1f\x8b"


def read(source: Source) -> YamlNode:
    """Return the value of a text, each part with its place in it.

    Raises:
        Unreadable: the first thing that is wrong with it.
    """
    if not source.text.strip():
        empty = YamlNode(None, Span(1, 1, 1, 2), source=source)
        raise Unreadable(error(empty, "this stack is empty", "not-a-stack"))
    root, findings = parse(attrs.evolve(source, text=_PAIR.sub(_join_pair, source.text)))
    if findings:
        raise Unreadable(Remark(attrs.evolve(findings[0], source=source)))
    assert root is not None, "a text without findings has a value"
    return _attach(root, source)


def _join_pair(pair: re.Match[str]) -> str:
    high, low = int(pair[2], 16) - 0xD800, int(pair[3], 16) - 0xDC00
    return f"{pair[1]}\\U{0x10000 + high * 0x400 + low:08x}"


def _attach(node: YamlNode, source: Source) -> YamlNode:
    """Return a value with its source, and with numbers as JSON has them."""
    value = node.value
    if isinstance(value, dict):
        value = {key: _attach(child, source) for key, child in value.items()}
    elif isinstance(value, list):
        value = [_attach(child, source) for child in value]
    elif isinstance(value, str) and _JSON_NUMBER.fullmatch(value) and not _is_quoted(node, source):
        value = json.loads(value)  # YAML 1.1 reads 1e3 as text
    return attrs.evolve(node, value=value, source=source)


def _is_quoted(node: YamlNode, source: Source) -> bool:
    line = source.lines[node.span.line - 1]
    return line[node.span.column - 1] in "\"'"


def decode(data: YamlNode, what: str) -> Source:
    """Return the text that stands in a value as base64, perhaps compressed by gzip.

    Args:
        what: what the text is, as its name in findings.

    Raises:
        Unreadable: it is not such a text.
    """
    content = decode_base64(data)
    if content.startswith(_GZIP):
        content = _decompress(content, data)
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as fault:
        message = "this is neither a text nor gzip: is it an archive?"
        raise Unreadable(error(data, message, "bad-data")) from fault
    name = data.source.name if data.source else "stack"
    return Source(f"{name} ({what})", text)


def decode_base64(data: YamlNode) -> bytes:
    """Return the content of a value in base64. Raises Unreadable if it is not base64."""
    if not isinstance(data.value, str):
        message = f"expected text in base64, got {kind_of(data.value)}"
        raise Unreadable(error(data, message, "bad-data"))
    try:
        return base64.b64decode("".join(data.value.split()), validate=True)
    except (binascii.Error, ValueError) as fault:
        raise Unreadable(error(data, "this is not base64", "bad-data")) from fault


def _decompress(content: bytes, data: YamlNode) -> bytes:
    """Return what gzip has compressed, up to the size of a Rigelfile."""
    gzip = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        result = gzip.decompress(content, MOST_BYTES + 1)
    except zlib.error as fault:
        raise Unreadable(error(data, f"this is not gzip: {fault}", "bad-data")) from fault
    if len(result) > MOST_BYTES:
        raise Unreadable(error(data, f"this has more than {MOST_BYTES} bytes", "too-large"))
    if not gzip.eof:
        raise Unreadable(error(data, "the compressed data ends too early", "bad-data"))
    return result

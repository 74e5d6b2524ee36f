"""YAML that PyYAML and kubectl read alike: manifests and kubeconfigs.

kubectl's reader does not read some unquoted words as text that PyYAML does: y, n, 1e3, 0o17 ...
Every text that any YAML 1.1 or 1.2 reader could mistake is quoted.

The emitter gets our data as events. PyYAML's own way, by a node for each value, takes twenty times
as long, and a release of a thousand nodes has 140,000 values.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from io import StringIO
from typing import Any

import yaml

#: Unquoted, some reader other than PyYAML reads these as a boolean, a number or a merge key.
MISTAKABLE = re.compile(
    r"""(?ix)
    y|n|yes|no|on|off|true|false|null|~|<<|=|
    [-+]?(\.inf|\.nan|inf|nan)|
    [-+]?[0-9._][0-9a-fox_.:+-]*|
    [-+]?\.?[0-9][0-9_.]*(e[-+]?[0-9]+)?
    """
)
#: Longer lines are folded only in quoted texts.
WIDTH = 4096

#: How PyYAML reads an unquoted text.
RESOLVER: Any = yaml.resolver.Resolver()

#: LibYAML's emitter and reader; PyYAML's own, which do the same, if it was built without.
Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

IMPLICIT = (True, True)
MAPPING = yaml.MappingStartEvent(None, None, True, flow_style=False)
MAPPING_END = yaml.MappingEndEvent()
SEQUENCE = yaml.SequenceStartEvent(None, None, True, flow_style=False)
SEQUENCE_END = yaml.SequenceEndEvent()


def documents(objects: Iterable[Mapping[str, Any]]) -> str:
    """Return objects as one text of several YAML documents."""
    return write(objects, explicit=True)


def document(content: Mapping[str, Any] | Sequence[Any]) -> str:
    """Return a mapping or a list as YAML."""
    return write([content], explicit=False)


def write_value(value: Any, *, flow: bool = False) -> str:
    """Return a value of ROS as PyYAML writes it, without a line end; lists in a line if `flow`."""
    text: str = yaml.dump(
        value,
        Dumper=Dumper,
        default_flow_style=flow,
        sort_keys=False,
        allow_unicode=True,
        width=1 << 30,
    )
    return text.removesuffix("\n").removesuffix("\n...")


def write(objects: Iterable[Mapping[str, Any] | Sequence[Any]], *, explicit: bool) -> str:
    """Return objects as YAML; `explicit`: each begins with `---`."""
    stream = StringIO()
    dumper = Dumper(stream, width=WIDTH)
    dumper.open()
    for item in objects:
        dumper.emit(yaml.DocumentStartEvent(explicit=explicit))
        emit_value(dumper.emit, item)
        dumper.emit(yaml.DocumentEndEvent(explicit=False))
    dumper.close()
    return stream.getvalue()


def emit_value(emit: Callable[[yaml.Event], None], value: Any) -> None:
    """Emit a value of JSON's types; a repeated value is written again, without anchors."""
    if isinstance(value, str):  # most are
        emit(scalar(value))
    elif isinstance(value, dict | Mapping):  # dict first: the check for Mapping is slow
        emit(MAPPING)
        for key, item in value.items():
            emit(scalar(key))
            emit_value(emit, item)
        emit(MAPPING_END)
    elif isinstance(value, list | tuple):
        emit(SEQUENCE)
        for item in value:
            emit_value(emit, item)
        emit(SEQUENCE_END)
    else:
        emit(scalar(value))


@lru_cache(maxsize=4096, typed=True)
def scalar(value: Any) -> yaml.ScalarEvent:
    """Return the event of a text, number, boolean or null."""
    if isinstance(value, str):
        return yaml.ScalarEvent(None, None, IMPLICIT, value, style=text_style(value))
    node = yaml.representer.SafeRepresenter().represent_data(value)
    return yaml.ScalarEvent(None, None, IMPLICIT, node.value)


def text_style(text: str) -> str | None:
    """Return how to write a text: quoted if it could be mistaken, as a block if it has lines."""
    tag = RESOLVER.resolve(yaml.ScalarNode, text, IMPLICIT)
    if MISTAKABLE.fullmatch(text) or tag != RESOLVER.DEFAULT_SCALAR_TAG:
        return '"'
    return "|" if "\n" in text and not re.search(r"[ \t]\n|\t", text) else None

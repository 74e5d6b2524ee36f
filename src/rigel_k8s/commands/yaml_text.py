"""Manifests as YAML that PyYAML and kubectl read alike.

kubectl's reader takes more unquoted words for something else than PyYAML does: y, n, 1e3, 0o17 ...
Every text that any YAML 1.1 or 1.2 reader could mistake is quoted.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import yaml

__all__ = ["documents"]

#: Unquoted, some reader takes these for a boolean, null, a number, a date or a merge key.
MISTAKABLE = re.compile(
    r"""(?ix)
    y|n|yes|no|on|off|true|false|null|~|<<|=|
    [-+]?(\.inf|\.nan|inf|nan)|
    [-+]?[0-9._][0-9a-fox_.:+-]*|
    [-+]?\.?[0-9][0-9_.]*(e[-+]?[0-9]+)?
    """
)


class Dumper(yaml.SafeDumper):
    """Quotes what could be mistaken, writes long texts as blocks, repeats instead of aliasing."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write everything out: anchors surprise readers of manifests."""
        return True


def text(dumper: yaml.SafeDumper, value: str) -> yaml.ScalarNode:
    """Return a text's YAML: quoted where mistakable, a block where it has lines."""
    style = None
    if MISTAKABLE.fullmatch(value) or not value:
        style = '"'
    elif "\n" in value and not re.search(r"[ \t]\n|\t", value):
        style = "|"
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=style)


Dumper.add_representer(str, text)


def documents(objects: Iterable[Mapping[str, Any]]) -> str:
    """Return objects as one multi-document YAML text."""
    return "".join(
        "---\n" + yaml.dump(dict(item), Dumper=Dumper, sort_keys=False, width=4096)
        for item in objects
    )

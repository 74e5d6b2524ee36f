"""Options that bring in what stands in other files: the seam, not what is brought in.

An option class may have a static method `expand(node, surroundings) -> Expanded`. It returns the
options with what the other file says in place of the key that names it. The values keep their
places in that file (`YamlNode.source`), so that a problem with one of them is reported there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.rigelfile.findings import Finding
from rigel_k8s.rigelfile.source import YamlNode


@attrs.frozen
class Surroundings:
    """Where options stand, and what may be read for them.

    Attributes:
        home: the Rigelfile's directory; what lies outside of it needs trust.
        directory: the application's, where relative paths begin; None: unknown.
    """

    home: Path
    directory: Path | None


@attrs.frozen
class Expanded:
    """Options with what other files say, and what there is to say about those."""

    node: YamlNode
    findings: tuple[Finding, ...] = ()


def expand(node: YamlNode, options: Any, surroundings: Surroundings) -> Expanded:
    """Return options as their class expands them; as they are where it does not."""
    own = getattr(options, "expand", None)
    if own is None or not isinstance(node.value, dict):
        return Expanded(node)
    expanded: Expanded = own(node, surroundings)
    return expanded

"""Options that import the content of other files: the interface, not the content.

An option class may have a static method `expand(node, surroundings) -> Expanded`. It returns the
options with the other file's content in place of the key that names it. The values keep their
places in that file (`YamlNode.source`), so that a problem with one of them is reported there.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.rigelfile.findings import Finding
from rigel_k8s.rigelfile.scope import Scope
from rigel_k8s.rigelfile.source import YamlNode


@attrs.frozen
class Surroundings:
    """Where options stand, and what may be read for them.

    Attributes:
        home: the Rigelfile's directory; files outside of it need trust.
        directory: the application's, where relative paths begin; None: unknown.
        environ: the environment.
        fetched: what other machines answered so far, by URL; None: they must not be asked, because
            the options are only checked.
    """

    home: Path
    directory: Path | None
    environ: Mapping[str, str]
    fetched: MutableMapping[str, str] | None

    @classmethod
    def of(cls, scope: Scope, directory: Path | None) -> Surroundings:
        """Return the surroundings of options whose values are in a scope."""
        return cls(Path(scope.source.name).parent, directory, scope.environ, scope.fetched)


@attrs.frozen
class Expanded:
    """Options with the content of other files, and the findings about those."""

    node: YamlNode
    findings: tuple[Finding, ...] = ()


def expand(node: YamlNode, options: Any, surroundings: Surroundings) -> Expanded:
    """Return options as their class expands them; unchanged if it does not."""
    own = getattr(options, "expand", None)
    if own is None or not isinstance(node.value, dict):
        return Expanded(node)
    expanded: Expanded = own(node, surroundings)
    return expanded

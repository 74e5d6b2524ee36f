"""Keys of an option class that another installed package adds, such as Muto's stacks.

Such a key stands for the content of another file: before anything else reads the options, it is
replaced by values that keep their places in that file (`YamlNode.source`), so that a problem with
one of them is reported there. The class has `extended_by`, the group of entry points with its
keys; each leads to an Extension.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.installed import find, list_names
from rigel_k8s.rigelfile.fields import Field, fields_by_key
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


@attrs.frozen
class Extension:
    """A key that a package adds to an option class.

    Attributes:
        field: what a user may write for it.
        expand: returns the options without the key, with what it stands for in its place.
    """

    field: Field
    expand: Callable[[YamlNode, Surroundings], Expanded]


def expand(node: YamlNode, options: Any, surroundings: Surroundings) -> Expanded:
    """Return options with the keys of other packages replaced; unchanged without such a key.

    Raises:
        UserError: a package that adds a key cannot be imported.
    """
    group = getattr(options, "extended_by", None)
    if group is None or not isinstance(node.value, dict):
        return Expanded(node)
    unknown = node.value.keys() - fields_by_key(options).keys()
    findings: list[Finding] = []
    for key in sorted(unknown & list_names(group)) if unknown else ():
        extension: Extension = find(group, key)
        expanded = extension.expand(node, surroundings)
        node = expanded.node
        findings += expanded.findings
    return Expanded(node, tuple(findings))


def list_added_fields(cls: Any) -> tuple[Field, ...]:
    """Return the keys that installed packages add to an option class."""
    group = getattr(cls, "extended_by", None)
    return tuple(find(group, name).field for name in sorted(list_names(group))) if group else ()

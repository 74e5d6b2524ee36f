"""Keys of an option class that stand for other values, such as Muto's stacks for nodes.

Before anything else reads the options, such a key is replaced by values with the places that they
come from: the key's own, or in another file (`YamlNode.source`). A problem with one of them is
reported there. The class has `expanded`, its own keys with their Extensions, and `extended_by`, the
group of entry points by which other installed packages add some.
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
    """A key of an option class that stands for others.

    Attributes:
        field: what a user may write for it.
        expand: returns the options without the key, with what it stands for in its place.
    """

    field: Field
    expand: Callable[[YamlNode, Surroundings], Expanded]

    @classmethod
    def of(
        cls,
        key: str,
        kind: Any,
        doc: str,
        expand: Callable[[YamlNode, Surroundings], Expanded],
        default: Any = None,
    ) -> Extension:
        """Return an extension by a key that may be left out."""
        return cls(Field(key, key, (), kind, required=False, default=default, doc=doc), expand)


def expand(node: YamlNode, options: Any, surroundings: Surroundings) -> Expanded:
    """Return options with the keys that stand for others replaced; unchanged without such a key.

    Raises:
        UserError: a package that adds a key cannot be imported.
    """
    if not isinstance(node.value, dict):
        return Expanded(node)
    own, group = _own(options), getattr(options, "extended_by", None)
    findings: list[Finding] = []
    found = [extension for key, extension in own.items() if key in node.value]
    if group is not None:
        unknown = node.value.keys() - fields_by_key(options).keys() - own.keys()
        installed = unknown & list_names(group) if unknown else ()
        found += [find(group, key) for key in sorted(installed)]
    for extension in found:
        expanded = extension.expand(node, surroundings)
        node = expanded.node
        findings += expanded.findings
    return Expanded(node, tuple(findings))


def list_added_fields(cls: Any) -> tuple[Field, ...]:
    """Return the keys of a class that stand for others, those of installed packages last."""
    group = getattr(cls, "extended_by", None)
    installed = (find(group, name) for name in sorted(list_names(group))) if group else ()
    return tuple(one.field for one in (*_own(cls).values(), *installed))


def _own(cls: Any) -> Mapping[str, Extension]:
    return getattr(cls, "expanded", {})

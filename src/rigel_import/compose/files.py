"""The services of a Compose file, with what they extend."""

from __future__ import annotations

from pathlib import Path

import attrs

from rigel_import.compose.values import Value, Variables, read_env_file
from rigel_import.draft import Place
from rigel_import.text import read_text
from rigel_k8s.rigelfile.findings import problems_error
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import Source

#: Keys whose value may be a list of NAME=value.
NAMED = ("environment", "args")
#: Lists that replace those of the service that is extended; others are joined.
REPLACED = ("command", "entrypoint")


class Project:
    """A Compose file with the files that it needs, each of which is read once.

    Its creation raises UserError if one of them cannot be read, or is not a Compose file.

    Attributes:
        content: the file itself.
        services: by name, with what they extend.
    """

    def __init__(self, file: Path) -> None:
        beside = file.parent / ".env"
        given = dict(read_env_file(read_text(beside))) if beside.is_file() else {}
        self.variables = Variables(given)
        self._loaded: dict[Path, Value] = {}
        self.content = self.load(file)
        names = self.content.get("services").entries()
        self.services = {name: self.complete(name, file) for name in names}
        if not self.services:
            hint = "pass a Docker Compose file; each entry of its `services` becomes a node"
            raise self.content.error("no `services` in this file", hint)
        for name, service in self.services.items():
            if not service.get("image").text and service.get("build").content is None:
                message = f'the service "{name}" has neither an `image` nor a `build`'
                merge = "`docker compose -f BASE -f THIS config > ALL`"
                raise service.error(message, f"add one; if it overrides another file, {merge}")

    def load(self, file: Path) -> Value:
        """Return the mapping in a file, with anchors and merges resolved."""
        if file not in self._loaded:
            source = Source(str(file), read_text(file))
            root, findings = parse(source)
            if findings:
                raise problems_error(source, findings)
            if root is None or not isinstance(root.value, dict):
                error = Value(Place(str(file), 1)).error
                raise error("this is not a mapping", "pass a Docker Compose file")
            self._loaded[file] = self.variables.read(root, file)
        return self._loaded[file]

    def complete(self, name: str, file: Path, above: tuple[tuple[str, Path], ...] = ()) -> Value:
        """Return a service of a file with what it extends; those in `above` extend it."""
        service = self.load(file).get("services", name)
        if not isinstance(service.content, dict):
            raise service.error(f'the service "{name}" is not a mapping', "write its keys below it")
        extends = service.get("extends")
        if extends.content is None:
            return service
        other = extends.get("file").path() if extends.get("file").text else file
        base = (extends.get("service").text or name) if extends.entries() else extends.text
        if (base, other) in (*above, (name, file)):
            raise extends.error(f'"{base}" extends itself', "remove this `extends`")
        if base not in self.load(other).get("services").entries():
            raise extends.error(f'no service "{base}" in {other}', "check `extends`")
        own = {key: value for key, value in service.content.items() if key != "extends"}
        below = self.complete(base, other, (*above, (name, file)))
        return merge(below, attrs.evolve(service, content=own))


def merge(base: Value, own: Value, key: str = "") -> Value:
    """Return a value of a service over that of the service that it extends."""
    if key in NAMED:
        return attrs.evolve(own, content={**base.pairs(), **own.pairs()})
    if isinstance(base.content, dict) and isinstance(own.content, dict):
        both = {
            name: merge(base.content[name], value, name) if name in base.content else value
            for name, value in own.content.items()
        }
        return attrs.evolve(own, content={**base.content, **both})
    if isinstance(base.content, list) and isinstance(own.content, list) and key not in REPLACED:
        return attrs.evolve(own, content=[*base.content, *own.content])
    return own

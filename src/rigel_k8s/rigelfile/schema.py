"""The JSON schema of Rigelfiles, for editors; generated from the classes that a check uses.

It is more lenient than a check: rules that need the whole file or a value's text are missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.rigelfile.expansion import list_added_fields
from rigel_k8s.rigelfile.fields import (
    Field,
    choices,
    describe_type,
    fields_of,
    is_list,
    is_mapping,
    is_scalar_class,
    members,
    nesting_key,
    summary,
    type_arguments,
    unwrap,
)
from rigel_k8s.rigelfile.model import (
    ApplicationEntry,
    JobEntry,
    ProviderEntry,
    Sections,
    SequenceSpec,
)
from rigel_k8s.rigelfile.source import YamlNode

DRAFT = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]
#: An option class under each of its names for `plugin:` or `provider:`.
Types = Mapping[tuple[str, ...], type[Any]]

_TEMPLATE: Schema = {"type": "string", "pattern": r"\{\{"}
_TEXT: Schema = {"type": ["string", "number"]}  # 1.10 and 8080 need no quotes
_MATRIX: Schema = {
    "type": "object",
    "additionalProperties": {"anyOf": [{"type": "array", "minItems": 1}, _TEMPLATE]},
}


def schema(jobs: Types, providers: Types) -> Schema:
    """Return the schema of Rigelfiles whose jobs and providers may be these."""
    made = _Definitions()
    sections: dict[str, Schema] = {
        "application": made.of(ApplicationEntry),
        "vars": {"type": ["object", "null"]},
        "jobs": _mapping_of(made.component(JobEntry, "plugin", jobs)),
        "providers": _mapping_of(made.component(ProviderEntry, "provider", providers)),
        "sequences": _mapping_of(made.of(SequenceSpec)),
    }
    fields = {field.key: field for field in fields_of(Sections)}
    properties = {key: {**inner, "description": fields[key].doc} for key, inner in sections.items()}
    return {
        "$schema": DRAFT,
        "title": "Rigelfile",
        "type": "object",
        "properties": properties,
        "required": [field.key for field in fields.values() if field.required],
        "additionalProperties": False,
        "$defs": made.definitions,
    }


def _mapping_of(inner: Schema) -> Schema:
    return {"type": ["object", "null"], "additionalProperties": inner}


class _Definitions:
    """Schemas of classes, each once, under its name in `$defs`."""

    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {}
        self._names: dict[type[Any], str] = {}

    def component(self, form: type[Any], key: str, types: Types) -> Schema:
        """Return the schema of a job or provider: its plugin decides what `with` may hold."""
        known = [name for names in types for name in names]
        base = self._object(form)
        base["properties"][key] |= {"anyOf": [{"enum": known}, {"type": "string"}]}
        base["properties"]["with"] = {"type": "object"}
        base["allOf"] = [
            {
                "if": {"properties": {key: {"enum": list(names)}}, "required": [key]},
                "then": {"properties": {"with": self._options(options)}},
            }
            for names, options in types.items()
            if attrs.has(options)
        ]
        return base

    def _options(self, cls: type[Any]) -> Schema:
        """Return what `with` may hold, directly or below the class's own key."""
        direct = self.of(cls)
        under = nesting_key(cls)
        if not under:
            return direct
        nested = {"type": "object", "properties": {under: direct}, "required": [under]}
        return {"if": {"required": [under]}, "then": nested, "else": direct}

    def of(self, kind: Any) -> Schema:
        """Return the schema of a type, templates left out at its top."""
        kind = unwrap(kind)
        if kind is YamlNode:
            return {"type": "object"}
        if kind is Any or kind is object:
            return {}
        if len(members(kind)) > 1:
            return {"anyOf": [self.of(member) for member in members(kind)]}
        if isinstance(kind, type) and attrs.has(kind):
            return {"$ref": f"#/$defs/{self._name(kind)}"}
        if is_mapping(kind):
            return {"type": "object", "additionalProperties": self._value(type_arguments(kind)[1])}
        if is_list(kind):
            return {"type": "array", "items": self._value(type_arguments(kind)[0])}
        return _scalar(kind)

    def _value(self, kind: Any) -> Schema:
        """Return the schema of a value, which may also be a template."""
        inner = self.of(kind)
        if not inner or inner == _TEXT or inner.get("type") == _TEXT["type"]:
            return inner
        options = inner["anyOf"] if set(inner) == {"anyOf"} else [inner]
        return {"anyOf": [*options, _TEMPLATE]}

    def _name(self, cls: type[Any]) -> str:
        if cls not in self._names:
            taken = self._names.values()
            name = cls.__name__
            number = 2
            while name in taken:
                name, number = f"{cls.__name__}{number}", number + 1
            self._names[cls] = name
            self.definitions[name] = {}
            self.definitions[name] = self._object(cls)
        return self._names[cls]

    def _object(self, cls: Any) -> Schema:
        fields = (*fields_of(cls), *list_added_fields(cls))
        made: Schema = {
            "type": "object",
            "description": summary(cls),
            "properties": {key: self._property(f) for f in fields for key in f.keys},
            "patternProperties": {r"\{\{": {}},
            "additionalProperties": False,
        }
        required = [field for field in fields if field.required]
        if required:
            made["allOf"] = [{"anyOf": [{"required": [k]} for k in f.keys]} for f in required]
        return made

    def _property(self, field: Field) -> Schema:
        made = dict(_MATRIX) if field.key == "matrix" else self._value(field.type)
        if field.doc:
            made = {**made, "description": field.doc}
        if isinstance(field.default, str | int | float):
            made = {**made, "default": field.default}
        return made


def _scalar(kind: Any) -> Schema:
    values = choices(kind)
    if values is not None:
        return {"enum": list(values)}
    if kind is bool:
        return {"type": "boolean"}
    if kind is type(None):
        return {"type": "null"}
    if is_scalar_class(kind):
        base = "integer" if issubclass(kind, int) else _TEXT["type"]
        return {"type": base, "description": describe_type(kind)}
    return {int: {"type": "integer"}, float: {"type": "number"}}.get(kind, dict(_TEXT))

"""Write the fields that patches may have, from the OpenAPI description of a Kubernetes version.

usage: python -m tools.kubefields VERSION SWAGGER.JSON

The file is api/openapi-spec/swagger.json of Kubernetes; in the module that the following command
fetches: go mod download -json k8s.io/kubernetes@v1.37.2

A line of the result is a type and its fields, `NAME:TYPE`, with a `!` behind the name if Kubernetes
requires the field. Types are other lines, `[TYPE]` for lists, `{TYPE}` for mappings from texts, and
scalars: `s` (text), `i` (whole number), `b` (truth), `q` (quantity), `n` (number or text), `*`
(any).
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

FILE = Path(__file__).parents[1] / "src/rigel_k8s/app/checks/fields.txt"
ROOTS = ("io.k8s.api.apps.v1.Deployment", "io.k8s.api.batch.v1.Job")
#: What only the cluster writes.
WRITTEN = ("status", "managedFields", "ownerReferences", "finalizers", "ephemeralContainers")
SCALARS = {"string": "s", "integer": "i", "boolean": "b", "number": "q", "object": "*"}
#: Types that are scalars in YAML.
PLAIN = {"Quantity": "q", "IntOrString": "n", "Time": "s", "MicroTime": "s"}

Definitions = Mapping[str, Mapping[str, Any]]


def main(words: list[str]) -> int:
    """Write the file; return the exit code."""
    version, path = words
    text = write(json.loads(Path(path).read_text("utf-8"))["definitions"], version)
    FILE.write_text(text, "utf-8")
    return 0


def write(definitions: Definitions, version: str) -> str:
    """Return the lines for the types that the roots are made of."""
    lines: dict[str, str] = {}
    todo = list(ROOTS)
    while todo:
        full = todo.pop()
        name = shorten(full)
        if name not in lines:
            fields = dict(list_fields(definitions[full]))
            lines[name] = " ".join([name, *(f"{key}:{kind}" for key, (kind, _) in fields.items())])
            todo += [below for _, below in fields.values() if below]
    head = f"# The fields of Kubernetes {version}; python -m tools.kubefields writes them.\n"
    return head + "".join(f"{line}\n" for _, line in sorted(lines.items()))


def shorten(full: str) -> str:
    """Return a type's own name: Probe."""
    return full.rpartition(".")[2]


def list_fields(definition: Mapping[str, Any]) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield each field of a type: its name, and its type as describe returns it."""
    required = definition.get("required", ())
    for name, field in sorted(definition.get("properties", {}).items()):
        if name not in WRITTEN:
            yield name + ("!" if name in required else ""), describe(field)


def describe(field: Mapping[str, Any]) -> tuple[str, str]:
    """Return a field's type, and the full name of the type with fields in it, "" for none."""
    if full := field.get("$ref", "").rpartition("/")[2]:
        return (plain, "") if (plain := PLAIN.get(shorten(full))) else (shorten(full), full)
    if field["type"] == "array":
        kind, below = describe(field["items"])
        return f"[{kind}]", below
    if isinstance(values := field.get("additionalProperties"), dict):
        kind, below = describe(values)
        return f"{{{kind}}}", below
    return SCALARS[field["type"]], ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

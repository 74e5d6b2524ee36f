"""Parameters of a node, or of the whole job, before they are arguments or files of a container."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any, TypeAlias

import attrs

from rigel_k8s.app.options import NodeOptions, OrchestrationOptions, ParameterFile
from rigel_k8s.objects.overlay import simplify
from rigel_k8s.substitution_args import has_substitution
from rigel_k8s.yaml_text import Loader

#: Where parameter files are mounted.
PARAMETERS_PATH = "/rigel-k8s-parameters"
#: What has parameters.
ParameterOptions: TypeAlias = NodeOptions | OrchestrationOptions


class FileLoader(Loader):  # type: ignore[misc]  # Any: with or without LibYAML
    """Reads a parameter file; angles have tags of rosparam's own."""


for tag in ("!degrees", "!radians"):
    FileLoader.add_constructor(tag, lambda loader, node: loader.construct_scalar(node))


@attrs.frozen
class Fault:
    """What is wrong with a parameter file.

    Attributes:
        mark: the line and column; None: it is about the file as a whole.
        ends: a node ends with such a file; else it is only a warning.
    """

    message: str
    mark: tuple[int, int] | None = None
    ends: bool = True


def list_global_keys(options: ParameterOptions) -> list[str]:
    """Return the keys of a job's parameters, which do not belong to a node."""
    keys = ("parameters", "parameter_files", "parameter_commands")
    return [key for key in keys if getattr(options, key)]


def file_of(item: str | ParameterFile) -> ParameterFile:
    """Return a parameter file, written as a path or in full."""
    return item if isinstance(item, ParameterFile) else ParameterFile(file=item)


def list_local(options: ParameterOptions) -> Iterator[tuple[str, str]]:
    """Yield (name in the ConfigMap, path as written) of the files that are mounted."""
    for number, entry in enumerate(map(file_of, options.parameter_files)):
        if entry.file:
            yield f"{number:02}-{make_key(entry.file)}.yaml", entry.file


def list_paths(options: ParameterOptions) -> Iterator[tuple[str, str]]:
    """Yield (path in the container, namespace) of all parameter files, in the order of loading."""
    mounted = {path: f"{PARAMETERS_PATH}/{name}" for name, path in list_local(options)}
    for entry in map(file_of, options.parameter_files):
        path = mounted[entry.file] if entry.file else entry.image_file
        yield path or "", str(entry.namespace or "").strip("~/")


def make_key(name: str) -> str:
    """Return a file's name as a valid key of a ConfigMap."""
    stem = PurePosixPath(name).stem
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in stem)[:200]


def flat(parameters: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the parameters of nested mappings, names joined by /."""
    for name, value in parameters.items():
        full = f"{prefix}{str(name).lstrip('~')}"
        if isinstance(value, Mapping) and value:
            yield from flat(value, f"{full}/")
        else:
            yield full, value


def flat_values(parameters: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Yield each parameter's first key, full name and value."""
    for key, value in parameters.items():
        for name, inner in flat({key: value}):
            yield str(key), name, inner


def unify_lists(value: Any) -> Any:
    """Return parameters as plain data that ROS 2 accepts: a list with a float has only floats."""
    if isinstance(value, Mapping):
        return {str(key): unify_lists(inner) for key, inner in value.items()}
    if isinstance(value, list) and {float} < {type(one) for one in value} <= {int, float}:
        return [float(one) for one in value]
    return simplify(value)


def is_list_of_one_type(values: Sequence[Any]) -> bool:
    """Return whether ROS 2 may have a type for a list; only a container knows some of its texts."""
    known = {type(one) for one in unify_lists(values) if not has_substitution(one)}
    return len(known) <= 1 and known <= {bool, int, float, str}


def tree(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters as a tree of plain data: `a/b` as b in a."""
    result: dict[str, Any] = {}
    for name, value in flat(parameters):
        *parents, last = name.strip("/").split("/")
        place = result
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = simplify(value)
    return result

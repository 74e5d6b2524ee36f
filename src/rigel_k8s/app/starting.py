"""The command line of inpod/start.sh, which fills in what only the container's image has."""

from __future__ import annotations

import json
import shlex
from collections.abc import Container, Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.app.environment import Extra, entries
from rigel_k8s.app.parameters import PARAMETERS_PATH, ParameterOptions, file_of, list_paths
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.text import split_words
from rigel_k8s.substitution_args import has_substitution, split_line

#: Parameters as JSON, which the script reads; it is beside the mounted parameter files.
VALUES = "99-parameters.json"


def needs_script(options: ParameterOptions) -> bool:
    """Return whether a container must be prepared by the script."""
    found = map(file_of, options.parameter_files)
    own = any(entry.image_file or entry.namespace for entry in found)
    return options.substitution_args or bool(options.parameter_commands) or own


def split(options: ParameterOptions, line: str | Sequence[Any]) -> list[str]:
    """Return a command line as a list; substitution args stay in one word (ValueError)."""
    together = options.substitution_args and isinstance(line, str)
    return split_line(str(line)) if together else split_words(line)


def begin(ros: str, options: ParameterOptions, env: Extra = ()) -> Iterator[str]:
    """Yield the first words: how parameters are loaded, ros1 or ros2, and what is substituted."""
    yield from ("/bin/sh", f"{SCRIPTS_PATH}/start.sh", ros)
    if options.substitution_args:
        yield "--substitute"
        for name, source in entries(env):
            if has_substitution(source.get("value")):
                yield from ("--env", name)


def complete_file(path: str) -> tuple[str, str]:
    """Return the words that complete a mounted JSON file, which the program's words name."""
    return "--complete", path


def list_steps(options: ParameterOptions, namespace: str) -> Iterator[str]:
    """Yield the words that set parameters of ROS 1 below a namespace."""
    above = namespace.rstrip("/")
    for path, below in list_paths(options):
        yield from ("--load", path, f"{above}/{below}".rstrip("/") or "/")
    if options.parameters:
        yield from load_values([VALUES], namespace)
    yield from list_run_steps(options, f"{above}/")


def load_values(mounted: Container[str], namespace: str) -> Iterator[str]:
    """Yield the words that read `write_values`' file, where it is mounted."""
    if VALUES in mounted:
        yield from ("--values", f"{PARAMETERS_PATH}/{VALUES}", namespace)


def list_run_steps(options: ParameterOptions, prefix: str = "") -> Iterator[str]:
    """Yield the words that run the commands of parameters."""
    for name, command in options.parameter_commands.items():
        line = shlex.join(split(options, command))
        yield from ("--run", f"{prefix}{str(name).lstrip('~/')}", line)


def write_values(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Return the file with parameters of plain data, by its name."""
    return {VALUES: json.dumps(parameters, indent=1, sort_keys=True) + "\n"}

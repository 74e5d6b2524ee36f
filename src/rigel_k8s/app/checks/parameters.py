"""What is wrong with parameters of a node or of the job, and with substitution args; pure.

Paths begin at the node or job.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

import attrs

from rigel_k8s.app.checks.lines import check_line
from rigel_k8s.app.checks.shells import runs_shell
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import ParameterOptions, file_of
from rigel_k8s.generation import Generation
from rigel_k8s.problems import Problem
from rigel_k8s.substitution_args import (
    FORMS,
    find_expressions,
    has_substitution,
    is_substituted,
    is_variable,
)

#: Where substitution args are replaced.
IN_PARAMETERS = ("parameters", "parameter_files", "parameter_commands")
IN_NODES = ("args", "command", "launch", "env", "components", *IN_PARAMETERS)
#: Where an expression is probably not meant as text, and the severity if it stays text.
NOT_LITERAL: Mapping[str, Literal["error", "warning"]] = {
    "parameter_files": "error",
    "parameter_commands": "error",
    "components": "warning",
    "parameters": "warning",
    "args": "warning",
}


def check_parameters(options: ParameterOptions, ros: Generation) -> Iterator[Problem]:
    """Yield files without a path, commands without a word, and what the generation refuses."""
    yield from ros.check_parameters(options)
    for index, entry in enumerate(map(file_of, options.parameter_files)):
        if bool(entry.file) == bool(entry.image_file):
            message = "set either file, beside the Rigelfile, or image_file"
            yield Problem(("parameter_files", index), message, "bad-parameter-file")
    for name, command in options.parameter_commands.items():
        yield from check_line(options, ("parameter_commands", str(name)), command)


def as_data(value: Any) -> Any:
    """Return an option as plain data, the fields of its parts too."""
    if isinstance(value, list):
        return [as_data(item) for item in value]
    if isinstance(value, Mapping):
        return {key: as_data(item) for key, item in value.items()}
    return attrs.asdict(value) if attrs.has(type(value)) else value


def check_substitution(
    options: NodeOptions | OrchestrationOptions, keys: tuple[str, ...]
) -> Iterator[Problem]:
    """Yield expressions that look as if they were replaced but are not."""
    for key in keys:
        value = as_data(getattr(options, key))
        if options.substitution_args:
            unknown = (
                text
                for text in find_expressions(value)
                if not is_substituted(text) and not is_variable(text)
            )
            for text in dict.fromkeys(unknown):
                message = f"unknown substitution arg {text}: use {FORMS}"
                yield Problem((key,), message, "unknown-substitution", at_key=True)
        elif key == "args" and isinstance(options, NodeOptions) and runs_shell(options):
            continue  # $(...) is the shell's
        elif key in NOT_LITERAL and has_substitution(value):
            text = next(filter(is_substituted, find_expressions(value)))
            message = f"{text} is not replaced: set substitution_args: true"
            severity = NOT_LITERAL[key]
            yield Problem((key,), message, "no-substitution", severity=severity, at_key=True)

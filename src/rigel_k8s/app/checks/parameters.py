"""What is wrong with parameters of a node or of the job, and with substitution args; pure.

Paths begin at the node or job.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

import attrs

from rigel_k8s.app.checks.lines import check_line
from rigel_k8s.app.checks.shells import runs_shell
from rigel_k8s.app.globalparameters import list_keys
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import ParameterOptions, file_of, flat, is_list_of_one_type
from rigel_k8s.objects.naming import Ros
from rigel_k8s.objects.scalars import RosName
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


def check_global_parameters(options: OrchestrationOptions, ros: Ros) -> Iterator[Problem]:
    """Yield what is wrong with the parameters of the job."""
    keys = list_keys(options)
    if ros != "1":
        what = "ROS 2" if ros == "2" else "a plain DDS application"
        for key in keys:
            message = f"{what} has no global parameters: write them as {key} of the nodes"
            yield Problem((key,), message, "no-global-parameters", at_key=True)
        return
    if options.substitution_args and not keys:
        message = (
            "this job has no global parameters with substitution args: set substitution_args of the"
            " nodes that need it"
        )
        path = ("substitution_args",)
        yield Problem(path, message, "incomplete", severity="warning", at_key=True)
    yield from check_parameters(options, ros)
    yield from check_substitution(options, IN_PARAMETERS)


def check_parameters(options: ParameterOptions, ros: Ros) -> Iterator[Problem]:
    """Yield names that are not ROS names, lists that ROS 2 refuses, files without a path, and
    commands without a word.
    """
    for key, name, value in flat_values(options.parameters) if ros == "2" else ():
        if isinstance(value, list) and not is_list_of_one_type(value):
            dotted = name.replace("/", ".")
            message = f'the list "{dotted}" must have values of one type'
            yield Problem(("parameters", key), message, "bad-parameter", at_key=True)
    for key, name in flat_keys(options.parameters) if ros == "1" else ():
        yield from check_name(("parameters", key), name)
    for index, entry in enumerate(map(file_of, options.parameter_files)):
        if bool(entry.file) == bool(entry.image_file):
            message = "set either file, beside the Rigelfile, or image_file"
            yield Problem(("parameter_files", index), message, "bad-parameter-file")
        if entry.namespace is not None and ros != "1":
            path = ("parameter_files", index, "namespace")
            message = "ROS 2 has no namespaces of parameters: write the names in full in the file"
            yield Problem(path, message, "no-parameter-namespace", at_key=True)
    for name, command in options.parameter_commands.items():
        if ros == "1":
            yield from check_name(("parameter_commands", str(name)), str(name).lstrip("~"))
        yield from check_line(options, ("parameter_commands", str(name)), command)


def check_name(path: tuple[str, ...], name: str) -> Iterator[Problem]:
    """Yield why a parameter cannot have a name."""
    try:
        RosName.parse(name)
    except ValueError as error:
        yield Problem(path, str(error), RosName.kind, at_key=True)
    else:
        if name == "/":
            message = "/ is a namespace: add the parameter's name"
            yield Problem(path, message, RosName.kind, at_key=True)


def flat_keys(parameters: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield each parameter's first key and full name."""
    for key, name, _ in flat_values(parameters):
        yield key, name


def flat_values(parameters: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Yield each parameter's first key, full name and value."""
    for key, value in parameters.items():
        for name, inner in flat({key: value}):
            yield str(key), name, inner


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

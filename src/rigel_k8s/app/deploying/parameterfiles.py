"""The parameter files beside a Rigelfile: read for a deploy, and checked with the options."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import yaml

from rigel_k8s.app.deploying.localfiles import Use, collect, explain, read_each
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import FileLoader, ParameterOptions, file_of
from rigel_k8s.errors import UserError
from rigel_k8s.problems import Path as OptionPath
from rigel_k8s.problems import Problem, Severity
from rigel_k8s.rigelfile.parse import find_excess
from rigel_k8s.substitution_args import find_expressions, is_substituted
from rigel_k8s.system.local_files import read_text

#: Bytes of one parameter file: a ConfigMap holds a mebibyte.
LARGEST_PARAMETER_FILE = 2**18
#: Characters of the parameter files of all nodes.
MOST_PARAMETERS = 2**24


#: The name of the option in errors whose place says which one it is.
WHAT = "parameter_files"
BEGINS = f"{WHAT}: "
TOO_MANY = UserError(
    f"the parameter files of all nodes have more than {MOST_PARAMETERS} characters",
    hint="split the file: it counts once for each node that uses it",
)


def read_parameter_files(
    options: OrchestrationOptions, directory: Path, home: Path
) -> dict[str, str]:
    """Return the texts of all parameter files, by the names in the Rigelfile.

    Args:
        directory: the application's, where relative paths begin.
        home: the Rigelfile's; files outside of it need trust.

    Raises:
        Untrusted: a file is elsewhere.
        UserError: a file cannot be read, is not YAML, or does not contain parameters.
    """
    uses = _read_each(options, directory, home)
    return collect(uses, BEGINS, lambda path: path[: path.index(WHAT) + 1])


def check_parameter_files(
    options: OrchestrationOptions, ros: Generation, directory: Path, home: Path
) -> Iterator[Problem]:
    """Yield what read_parameter_files or ROS would refuse, at each use.

    A path with a template waits.
    """
    uses = list(_read_each(options, directory, home))
    yield from explain(uses, BEGINS, "bad-parameter-file")
    for path, name, text in uses:
        if isinstance(text, str):
            yield from _check_use(options, ros, path, name, text)


def _check_use(
    options: OrchestrationOptions, ros: Generation, path: OptionPath, name: str, text: str
) -> Iterator[Problem]:
    key = str(path[1]) if path[0] == "nodes" else None
    node = options.nodes[key] if key else options
    own = ros.of_node(node) if isinstance(node, NodeOptions) else ros
    for fault in own.check_parameter_file(text, key, node):
        where = ":".join(map(str, (name, *(fault.mark or ()))))
        severity: Severity = "error" if fault.ends else "warning"
        yield Problem(path, f"{where}: {fault.message}", "bad-parameter-file", severity=severity)
    found = filter(is_substituted, find_expressions(yaml.load(text, FileLoader)))
    for expression in itertools.islice(found, 1):
        message = (
            f"{name}: {expression} is not replaced in a file: write this one in `parameters`, with"
            " substitution_args: true"
        )
        yield Problem(path, message, "no-substitution", severity="warning")


def _read_each(options: OrchestrationOptions, directory: Path, home: Path) -> Iterator[Use[str]]:
    named = _list_uses(options)
    return read_each(
        named, lambda name: _read(directory / name, home), len, MOST_PARAMETERS, TOO_MANY
    )


def _list_uses(options: OrchestrationOptions) -> Iterator[tuple[OptionPath, str]]:
    """Yield (path of the option, path as written) of each file, as often as it is used."""
    yield from _list_files(options, ())
    for key, node in options.nodes.items():
        yield from _list_files(node, ("nodes", str(key)))


def _list_files(options: ParameterOptions, above: OptionPath) -> Iterator[tuple[OptionPath, str]]:
    for index, item in enumerate(options.parameter_files):
        if name := file_of(item).file:
            inner = () if isinstance(item, str) else ("file",)
            yield (*above, "parameter_files", index, *inner), name


def _read(path: Path, home: Path) -> str:
    """Return a parameter file's text, after checking that it contains parameters."""
    try:
        text = read_text(path, home, LARGEST_PARAMETER_FILE, what=WHAT)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UserError(
            f"{WHAT}: cannot read {path}: {reason}",
            hint="write its path relative to the application's directory",
        ) from error
    if fault := _find_fault(text):
        raise UserError(f"{WHAT}: {path}{fault}")
    return text


@lru_cache(maxsize=MOST_PARAMETERS // LARGEST_PARAMETER_FILE)  # many uses of a job name one file
def _find_fault(text: str) -> str:
    """Return why a text does not contain parameters, behind the name of its file; "" if it does."""
    try:
        if excess := find_excess(text):
            return f":{excess.span.line}:{excess.span.column} is not YAML: {excess.message}"
        content = yaml.load(text, FileLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        return f"{where} is not YAML: {error.problem or error.context}"
    except (yaml.YAMLError, ValueError) as error:  # a date that does not exist
        return f" is not YAML: {error}"
    if not isinstance(content, dict):
        return " is not a mapping of parameter names to values"
    return ""

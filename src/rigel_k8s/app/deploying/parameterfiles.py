"""The parameter files beside a Rigelfile: read for a deploy, and checked with the options."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.parameters import ParameterOptions, file_of
from rigel_k8s.errors import UserError
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path as OptionPath
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile.parse import find_excess
from rigel_k8s.system.local_files import read_text
from rigel_k8s.system.trust import Untrusted
from rigel_k8s.yaml_text import Loader

#: Bytes of one parameter file: a ConfigMap holds a mebibyte.
LARGEST_PARAMETER_FILE = 2**18
#: Characters of the parameter files of all nodes.
MOST_PARAMETERS = 2**24


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
    uses = list(_list_uses(options))
    wheres = {name: _name_option(path) for path, name in uses}
    texts = {name: _read(directory / name, home, where) for name, where in wheres.items()}
    if sum(len(texts[name]) for _, name in uses) > MOST_PARAMETERS:
        raise UserError(TOO_MANY, hint=SPLIT)
    return texts


def check_parameter_files(
    options: OrchestrationOptions, directory: Path, home: Path
) -> Iterator[Problem]:
    """Yield what read_parameter_files would refuse, at each use; a path with a template waits."""
    found: dict[str, str | UserError] = {}
    total = 0
    for path, name in _list_uses(options):
        if has_template(name):
            continue
        if name not in found:
            try:
                found[name] = _read(directory / name, home, WHAT)
            except UserError as error:
                found[name] = error
        result = found[name]
        if isinstance(result, UserError):
            kind = "untrusted" if isinstance(result, Untrusted) else "bad-parameter-file"
            message = result.message.removeprefix(f"{WHAT}: ")
            text = "; ".join(filter(None, (message, *result.details, result.hint)))
            yield Problem(path, text, kind)
            continue
        total += len(result)
        if total > MOST_PARAMETERS:
            yield Problem(path, f"{TOO_MANY}; {SPLIT}", "bad-parameter-file")
            return


#: The name of the option in errors whose place says which one it is.
WHAT = "parameter_files"
TOO_MANY = f"the parameter files of all nodes have more than {MOST_PARAMETERS} characters"
SPLIT = "split the file: it counts once for each node that uses it"


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


def _name_option(path: OptionPath) -> str:
    """Return the option of a path, for errors without a place."""
    return ".".join(str(step) for step in path[: path.index("parameter_files") + 1])


def _read(path: Path, home: Path, where: str) -> str:
    """Return a parameter file's text, after checking that it contains parameters."""
    try:
        text = read_text(path, home, LARGEST_PARAMETER_FILE, what=where)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UserError(
            f"{where}: cannot read {path}: {reason}",
            hint="write its path relative to the application's directory",
        ) from error
    if fault := _find_fault(text):
        raise UserError(f"{where}: {path}{fault}")
    return text


@lru_cache(maxsize=MOST_PARAMETERS // LARGEST_PARAMETER_FILE)  # many uses of a job name one file
def _find_fault(text: str) -> str:
    """Return why a text does not contain parameters, behind the name of its file; "" if it does."""
    try:
        content = _parse(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        return f"{where} is not YAML: {error.problem or error.context}"
    except (yaml.YAMLError, ValueError) as error:  # a date that does not exist
        return f" is not YAML: {error}"
    if not isinstance(content, dict):
        return " is not a mapping of parameter names to values"
    return ""


def _parse(text: str) -> Any:
    """Return the content of a parameter file."""
    if excess := find_excess(text):
        raise yaml.YAMLError(f"{excess.span.line}:{excess.span.column}: {excess.message}")
    return yaml.load(text, Loader)

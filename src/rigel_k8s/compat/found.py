"""Which job of the Rigelfile a plugin is: Rigel passes a plugin its data but not its name.

Rigel has rendered that data its own way (filters stay as they are, 1.10 is 1.1), so the Rigelfile
is read again; the data that Rigel passed only identifies the job.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.jobs.names import Builtin
from rigel_k8s.option_text import has_template
from rigel_k8s.rigelfile import Rigelfile, preview
from rigel_k8s.rigelfile.model import JobUse


@attrs.frozen
class CommandLine:
    """The words of `rigel run job|sequence NAME [-f FILE]`; None for any other command."""

    job: str | None = None
    sequence: str | None = None
    file: Path = Path("Rigelfile")


def command_line(argv: Sequence[str] | None = None) -> CommandLine:
    """Parse Rigel's command line (by default sys.argv)."""
    words = iter((sys.argv if argv is None else argv)[1:])
    names: list[str] = []
    file = "Rigelfile"
    for word in words:
        if word in ("-f", "--file"):
            file = next(words, file)
        elif word.startswith("--file="):
            file = word.partition("=")[2]
        elif word.startswith("-f"):
            file = word[2:]
        else:
            names.append(word)
    if len(names) != 3 or names[0] != "run" or names[1] not in ("job", "sequence"):
        return CommandLine()
    job, sequence = (names[2], None) if names[1] == "job" else (None, names[2])
    return CommandLine(job, sequence, Path(file))


def find_use(
    rigelfile: Rigelfile,
    builtin: Builtin,
    options: type[Any],
    given: Mapping[str, Any],
    data: Mapping[str, Any],
    line: CommandLine,
) -> JobUse:
    """Return the job that a plugin with this data is.

    Raises:
        UserError: no job of that plugin has such data.
    """
    uses = [
        use
        for use in _candidates(rigelfile, line)
        if rigelfile.jobs[use.name].plugin.strip() in builtin.names
    ]
    for use in uses:
        spec = rigelfile.jobs[use.name]
        raw = preview(rigelfile, spec, use.overrides, dict(data), options).raw
        if _is_same_value(given, raw):
            return use
    if len(uses) == 1:
        return uses[0]
    known = ", ".join(dict.fromkeys(use.name for use in uses)) or "none"
    raise UserError(
        f"cannot find out which job of {line.file} this is; its jobs of that plugin: {known}",
        hint="run it with `rigel-k8s run`",
    )


def _candidates(rigelfile: Rigelfile, line: CommandLine) -> Iterator[JobUse]:
    if line.job and line.job in rigelfile.jobs:
        yield JobUse(line.job)
    elif line.sequence and line.sequence in rigelfile.sequences:
        yield from rigelfile.sequences[line.sequence].list_uses()
    else:
        yield from map(JobUse, rigelfile.jobs)
        for sequence in rigelfile.sequences.values():
            yield from sequence.list_uses()


def _is_same_value(given: Any, ours: Any) -> bool:
    """Return whether both are the same value, written by Rigel's rules and by ours."""
    if isinstance(given, Mapping) and isinstance(ours, Mapping):
        return given.keys() == ours.keys() and all(_is_same_value(given[k], ours[k]) for k in given)
    if isinstance(given, list) and isinstance(ours, list):
        return len(given) == len(ours) and all(map(_is_same_value, given, ours))
    if isinstance(given, str) and has_template(given):  # a template that Rigel does not support
        return True
    return given == ours or _is_same_number(given, ours)


def _is_same_number(given: Any, ours: Any) -> bool:
    """Return whether Rigel made 1.1 of "1.10", or a number became text."""
    try:
        return not isinstance(given, bool) and float(given) == float(ours)
    except (TypeError, ValueError):
        return str(given).lower() == str(ours).lower()

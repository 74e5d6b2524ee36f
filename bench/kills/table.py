"""The results of kills as a table, with a row for each write of each command.

docs/reliability-tests.md has it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import attrs

from bench.kills.killing import MOMENTS, Moment

HEAD = "| command | write | before | sent | after | kills |"
RULE = "|---|---|---|---|---|---|"
#: Around the table in the document.
BEGIN, END = "<!-- kills -->", "<!-- /kills -->"


@attrs.frozen
class Kill:
    """One kill, and the result of the same command after it."""

    scenario: str
    step: str
    moment: Moment
    result: str


def draw(kills: Sequence[Kill]) -> Iterator[str]:
    """Yield the lines of the table, in the order of the first kill of each row."""
    yield HEAD
    yield RULE
    rows: dict[tuple[str, str], dict[Moment, list[str]]] = {}
    for kill in kills:
        row = rows.setdefault((kill.scenario, kill.step), {})
        row.setdefault(kill.moment, []).append(kill.result)
    for (scenario, step), found in rows.items():
        cells = [summarize(found.get(moment, [])) for moment in MOMENTS]
        count = sum(map(len, found.values()))
        yield f"| {scenario} | {step} | {' | '.join(cells)} | {count} |"


def summarize(results: Iterable[str]) -> str:
    """Return the results of the kills of a cell."""
    return ", ".join(sorted(set(results))) or "-"


def read_steps(document: str) -> Mapping[str, set[str]]:
    """Return the writes by command in a document's table."""
    found: dict[str, set[str]] = {}
    for scenario, step in re.findall(r"^\| ([^|]+) \| (\w+ \w+ [^|]+) \|", document, re.MULTILINE):
        found.setdefault(scenario, set()).add(step.strip())
    return found


def renew(document: str, drawn: Sequence[str]) -> str:
    """Return a document with new rows; the rows of commands that were not run stay."""
    start, end = document.index(BEGIN) + len(BEGIN), document.index(END)
    rows = [line for line in drawn if line.startswith("| ") and line != HEAD]
    run = {row.split(" | ")[0] for row in rows}
    old = [line for line in document[start:end].splitlines() if re.search(r"\| \d+ \|$", line)]
    kept = [line for line in old if line.split(" | ")[0] not in run]
    table = "\n".join((HEAD, RULE, *kept, *rows))
    return f"{document[:start]}\n{table}\n{document[end:]}"

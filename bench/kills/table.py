"""The results of kills as a table of docs/reliability.md: a row for each write of each command."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import attrs

from bench.kills.killing import MOMENTS, Moment

HEAD = "| command | write | before | sent | after | kills |"
RULE = "|---|---|---|---|---|---|"


@attrs.frozen
class Kill:
    """One kill and what the same command did then."""

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
    """Return what came of the kills of a cell."""
    return ", ".join(sorted(set(results))) or "-"


def read_steps(document: str) -> Mapping[str, set[str]]:
    """Return the writes by command that a document's table has."""
    found: dict[str, set[str]] = {}
    for scenario, step in re.findall(r"^\| ([^|]+) \| (\w+ \w+ [^|]+) \|", document, re.MULTILINE):
        found.setdefault(scenario, set()).add(step.strip())
    return found

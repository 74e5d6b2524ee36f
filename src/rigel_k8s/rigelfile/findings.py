"""Problems with their places, and how they look: file:line:column, the line, a caret."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal

import attrs

from rigel_k8s.errors import ProblemsError
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile.limits import LONGEST_LINE, LONGEST_MESSAGE, MOST_PROBLEMS
from rigel_k8s.rigelfile.source import Source, Span, YamlNode, locate

# Beyond these, the search for a suggestion takes longer than all the rest.
_LONGEST_WORD, _MOST_NAMES, _FAR = 64, 300, 20
# Columns of a line that are shown however narrow the terminal is.
_LEAST_ROOM = 30


@attrs.frozen
class Finding:
    """A Problem with its place in the text.

    Attributes:
        span: its place; for a value from a template, the place of the template.
        defined_at: the place of the var that gave the value.
        environment: the environment variable that gave the value.
        source: the text that the span is of; None is the Rigelfile itself.
    """

    span: Span
    message: str
    kind: str
    severity: Literal["error", "warning"] = "error"
    defined_at: Span | None = None
    environment: str | None = None
    source: Source | None = None


def make_finding(node: YamlNode, message: str, kind: str, *, key: bool = False) -> Finding:
    """Return an error about a node, or about its key."""
    if key and node.key_span:
        span, defined_at, environment = node.key_span, node.key_defined_at, None
    else:
        span, defined_at, environment = node.span, node.defined_at, node.environment
    return Finding(
        span, message, kind, defined_at=defined_at, environment=environment, source=node.source
    )


def place(root: YamlNode, problem: Problem) -> Finding:
    """Return a problem with a path below `root` as a finding in the text."""
    finding = make_finding(
        locate(root, problem.path), problem.message, problem.kind, key=problem.at_key
    )
    return attrs.evolve(finding, severity=problem.severity)


def sort_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings in the order of the file, each once, up to a maximum."""
    found = sorted(dict.fromkeys(findings), key=_order)
    if len(found) <= MOST_PROBLEMS:
        return tuple(found)
    errors = [finding for finding in found if finding.severity == "error"]
    shown = [*errors, *(finding for finding in found if finding.severity != "error")]
    shown = sorted(shown[:MOST_PROBLEMS], key=_order)
    severity: Literal["error", "warning"] = "error" if errors else "warning"
    message = f"more than {MOST_PROBLEMS} problems: the others are not shown"
    last = attrs.evolve(shown[-1], message=message, kind="too-many", severity=severity)
    return (*shown, last)


def _order(finding: Finding) -> tuple[str, Span, Span, str]:
    """Sort by file, the Rigelfile first, and by place."""
    name = finding.source.name if finding.source else ""
    return name, finding.span, finding.defined_at or finding.span, finding.message


def render(
    source: Source, finding: Finding, *, marked: bool = True, width: int = LONGEST_LINE
) -> str:
    """Return a finding as text: the message, the line it is about, a caret below.

    Args:
        source: the Rigelfile; a finding about another text names that one.
        marked: begin a warning with "warning:"; false if the caller prints that.
        width: columns; a longer line of the file is cut around the caret.
    """
    source = finding.source or source
    span = finding.span
    mark = "warning: " if marked and finding.severity == "warning" else ""
    message = _show(finding.message, LONGEST_MESSAGE)
    head = f"{source.name}:{span.line}:{span.column}: {mark}{message}{_origin(finding)}"
    lines = source.lines
    shown = [span, finding.defined_at] if finding.defined_at else [span]
    gutter = len(str(max(place.line for place in shown)))
    snippets = [text for place in shown for text in _snippet(lines, place, gutter, width)]
    return "\n".join([f"{head} [{finding.kind}]", *snippets])


def _origin(finding: Finding) -> str:
    if finding.defined_at:
        return f" (defined at {finding.defined_at.line}:{finding.defined_at.column})"
    if finding.environment:
        return f" (from the environment variable {finding.environment})"
    return ""


def _show(text: str, longest: int) -> str:
    """Return a text that is safe on a terminal: without control characters, and not too long.

    Control characters could move the cursor and overwrite the report.
    """
    shown = text if len(text) <= longest else f"{text[: longest - 4]} ..."
    return "".join(
        c if c.isprintable() or c == "\t" else "\N{REPLACEMENT CHARACTER}" for c in shown
    )


def _snippet(lines: Sequence[str], span: Span, gutter: int, width: int) -> Iterator[str]:
    """Yield the line of a place, and below it a caret under the place."""
    if span.line > len(lines) or not lines[span.line - 1].strip():
        return
    whole = lines[span.line - 1].rstrip()
    line, first = _cut(whole, span.column - 1, max(_LEAST_ROOM, width - gutter - len(" | ")))
    line = _show(line, len(line))
    lead = "".join("\t" if c == "\t" else " " for c in line[: span.column - 1 - first])
    end = span.end_column if span.end_line == span.line else len(whole) + 1
    marked = max(1, min(end - first, len(line) + 1) - (span.column - first))
    yield f"{span.line:>{gutter}} | {line}"
    yield f"{'':>{gutter}} | {lead}^{'~' * (marked - 1)}"


def _cut(line: str, at: int, room: int) -> tuple[str, int]:
    """Return the part of a line around a character, and how many characters are before it.

    `...` marks that the line continues.
    """
    if len(line) <= room:
        return line, 0
    first = min(max(0, at - room // 2), len(line) - room)
    part = line[first : first + room]
    if first:
        part = "..." + part[3:]
    if first + room < len(line):
        part = part[:-3] + "..."
    return part, first


def problems_error(source: Source, findings: Iterable[Finding]) -> ProblemsError:
    found = sort_findings(findings)
    count = sum(finding.severity == "error" for finding in found)
    return ProblemsError(
        f"{source.name} has {count} {'problem' if count == 1 else 'problems'}",
        lambda width: [render(source, finding, width=width) for finding in found],
        width=LONGEST_LINE,
    )


def find_nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that is most similar, if any is."""
    if len(word) > _LONGEST_WORD:
        return None
    names = itertools.islice((n for n in known if abs(len(n) - len(word)) < _FAR), _MOST_NAMES)
    folded, by_folded = _fold(word), {_fold(name): name for name in names}

    def rank(name: str) -> tuple[float, int]:
        """How similar a name is, and where it is as similar as another, how many letters fit."""
        similar = difflib.SequenceMatcher(None, name, folded).ratio()
        alike = itertools.takewhile(
            lambda pair: pair[0] == pair[1], zip(name, folded, strict=False)
        )
        return similar, sum(1 for _ in alike)

    close = difflib.get_close_matches(folded, by_folded, n=3, cutoff=0.6)
    return by_folded[max(close, key=rank)] if close else None


def _fold(word: str) -> str:
    return word.lower().replace("-", "_")


def name_nearest(word: str, known: Iterable[str]) -> str:
    """Return `, did you mean "x"?`, or "" if none is similar."""
    near = find_nearest(word, known)
    return f', did you mean "{near}"?' if near else ""


def suggest(word: str, known: Iterable[str]) -> str:
    """Return `, did you mean "x"?`, or the known words if none is similar and they are few."""
    names = list(known)
    near = name_nearest(word, names)
    if near or not names:
        return near
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f" (known: {shown})"

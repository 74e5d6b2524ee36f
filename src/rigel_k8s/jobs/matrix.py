"""A matrix: its combinations, its waves of branches, and the outcome of each.

The limits of waves (how many branches at once, when to stop) are in the matrix itself, as lists of
one number: Rigel 0.3 refuses any other key of a stage, and reads these as two more keys of its
combinations. Independent of jobs and threads.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, TypeAlias, TypeVar

import attrs

from rigel_k8s.errors import JobFailed
from rigel_k8s.rigelfile.model import LIMITS, MAX_PARALLEL, STOP_AFTER

T = TypeVar("T")
State: TypeAlias = Literal["done", "failed", "stopped", "not begun"]


def combinations(matrix: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Return the combinations; no key gives the one empty combination, an empty list gives none."""
    return [
        dict(zip(matrix, choice, strict=True)) for choice in itertools.product(*matrix.values())
    ]


def label(combination: Mapping[str, Any]) -> str:
    """Return a branch's name: `distro=noetic, arch=arm64`."""
    return ", ".join(f"{key}={value}" for key, value in combination.items())


@attrs.frozen
class Limits:
    """How a matrix runs in waves.

    Attributes:
        max_parallel: branches of one wave; None is all of them.
        stop_after: after how many failures no further wave begins.
    """

    max_parallel: int | None = None
    stop_after: int = 1

    def waves(self, parts: Sequence[T]) -> list[Sequence[T]]:
        """Return the parts in waves, in their order."""
        size = self.max_parallel or max(len(parts), 1)
        return [parts[start : start + size] for start in range(0, len(parts), size)]


@attrs.frozen
class Outcome:
    """The outcome of a branch; `cause` is why it failed."""

    name: str
    state: State
    cause: JobFailed | None = None


def split_limits(
    matrix: Mapping[str, Sequence[Any]],
) -> tuple[dict[str, Sequence[Any]], Limits | None]:
    """Return a matrix without its limits, and the limits; None if it has none."""
    rest = {key: values for key, values in matrix.items() if key not in LIMITS}
    if len(rest) == len(matrix):
        return rest, None
    first = {key: int(matrix[key][0]) for key in LIMITS if key in matrix}
    return rest, Limits(first.get(MAX_PARALLEL), first.get(STOP_AFTER, 1))


def find_limit_fault(key: str, values: object) -> str | None:
    """Return what is wrong with the value of a limit; None if it is right or not a limit."""
    if key not in LIMITS:
        return None
    fits = isinstance(values, list) and len(values) == 1 and type(values[0]) is int
    if fits and values[0] > 0:  # type: ignore[index]  # it is a list
        return None
    return f"{key} of a matrix must be a list of one number above 0: {key}: [3]"


def count_failures(outcomes: Sequence[Outcome]) -> int:
    """Return how many branches have failed."""
    return sum(outcome.state == "failed" for outcome in outcomes)


def summarise(outcomes: Sequence[Outcome]) -> str:
    """Return in one line how many branches ended in which state."""
    states = [outcome.state for outcome in outcomes]
    counts = [f"{states.count(state)} {state}" for state in dict.fromkeys(states)]
    return f"{len(outcomes)} in all: {', '.join(counts)}"


def list_outcomes(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Yield a line for each state, and each failure."""
    for state in ("done", "stopped", "not begun"):
        if names := [outcome.name for outcome in outcomes if outcome.state == state]:
            yield f"{state}: {'; '.join(names)}"
    for outcome in outcomes:
        if outcome.cause is not None:
            yield f"failed: {outcome.cause.message}"
            yield from (f"  {detail}" for detail in outcome.cause.details)
            if outcome.cause.hint:
                yield f"  hint: {outcome.cause.hint}"


def failure(outcomes: Sequence[Outcome]) -> JobFailed:
    """Return the error for a matrix of which some branches have failed."""
    left = any(outcome.state == "not begun" for outcome in outcomes)
    return JobFailed(
        f"{count_failures(outcomes)} of {len(outcomes)} branches failed",
        details=list(list_outcomes(outcomes)),
        hint="run it again: what is up to date is not changed"
        + (f"; set a higher `{STOP_AFTER}` to continue after more failures" if left else ""),
    )

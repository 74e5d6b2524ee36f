"""What the lines of worker.py and caller.py say of updates; pure.

The caller's lines are TIME KIND ..., the workers' TIME VERSION KIND NUMBER, in any order.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Sequence

import attrs


@attrs.frozen
class Verdict:
    """What was lost or came twice.

    Attributes:
        versions: of the talkers, in the order in which they were heard.
        gaps: seconds between the last message of a version and the first one of the next.
        doubled: messages that came twice.
        late: messages of an old one that came after the new one's first.
        missing: messages that a talker published while it worked and that did not come.
        calls: how many were answered.
        calls_lost: those without an answer.
        calls_twice: those that two workers handled, or one twice.
        slowest: milliseconds of the slowest call.
        goals: how many succeeded.
        goals_lost: those that did not: refused, cancelled, or without an answer.
        goals_twice: those that were begun twice.
        longest: seconds of the goal that took longest, its wait included.
        maps: the latched messages, in the order in which they came: one of each version, but the
            first version's may have come before the lines begin.
        counted: how many numbers the workers have handled.
        counted_twice: those that were handled more than once.
        uncounted: those between the first and the last that no worker handled.
    """

    versions: tuple[str, ...]
    gaps: tuple[float, ...]
    doubled: int
    late: int
    missing: int
    calls: int
    calls_lost: tuple[int, ...]
    calls_twice: tuple[int, ...]
    slowest: float
    goals: int
    goals_lost: tuple[int, ...]
    goals_twice: tuple[int, ...]
    longest: float
    maps: tuple[str, ...]
    counted: int
    counted_twice: tuple[int, ...]
    uncounted: tuple[int, ...]

    @property
    def faults(self) -> dict[str, object]:
        """What a hand-over must not do, as far as it was done: empty if all is well."""
        names = ("doubled", "late", "missing", "calls_lost", "calls_twice")
        names = (*names, "goals_lost", "goals_twice", "counted_twice", "uncounted")
        found = {name: getattr(self, name) for name in names}
        expected = self.versions[self.maps[:1] != self.versions[:1] :]
        if self.maps not in {(), expected}:  # some callers do not listen to it
            found["maps"] = self.maps
        return {name: value for name, value in found.items() if value}


def is_answered(caller: str, since: float) -> bool:
    """Whether a call was answered after a time, so that no older one is open and may be lost."""
    calls = (
        words for words in _lines(caller) if words[1] == "call" and words[3:] not in ([], ["lost"])
    )
    return any(float(words[0]) > since for words in calls)


def judge(caller: str, workers: str, chat: str = "chat") -> Verdict:
    """Return what the caller's and all workers' lines say.

    What was lost before the first answer was lost because they had not found each other.

    Args:
        chat: the kind of the lines about what was heard; "chat/NAME" of another talker.
    """
    called, handled = list(_lines(caller)), list(_lines(workers))
    heard = [(float(w[0]), w[2], int(w[3])) for w in called if w[1] == chat]
    answers = [(float(w[0]), int(w[2]), w[3:]) for w in called if w[1] == "call"]
    goals = [(float(w[0]), int(w[2]), w[3]) for w in called if w[1] == "goal"]
    answered = {number: float(words[1]) for _, number, words in answers if words[0] != "lost"}
    lost = {number for _, number, _ in answers} - set(answered)
    sent = {number: when for when, number, word in goals if word == "sent"}
    reached = {number: when for when, number, word in goals if word == "succeeded"}
    over = {n for _, n, word in goals if word in {"lost", "refused"} or "status" in word}
    counted = _numbers(handled, "count")
    return Verdict(
        *_of_chatter(heard),
        calls=len(answered),
        calls_lost=tuple(sorted(n for n in lost if n > min(answered, default=0))),
        calls_twice=_twice(_numbers(handled, "call")),
        slowest=max(answered.values(), default=0.0),
        goals=len(reached),
        goals_lost=tuple(sorted(n for n in over - set(reached) if n > min(reached, default=0))),
        goals_twice=_twice(_numbers(handled, "begin")),
        longest=max((reached[n] - sent[n] for n in reached if n in sent), default=0.0),
        maps=tuple(words[2] for words in called if words[1] == "map"),
        counted=len(counted),
        counted_twice=_twice(counted),
        uncounted=_holes(counted),
    )


def _lines(text: str) -> Iterable[list[str]]:
    for line in text.splitlines():
        words = line.split()
        if len(words) > 2 and words[0].replace(".", "", 1).isdigit():
            yield words


def _of_chatter(
    chat: Sequence[tuple[float, str, int]],
) -> tuple[tuple[str, ...], tuple[float, ...], int, int, int]:
    """Return versions, gaps, and how many came twice, came late, and did not come."""
    first: dict[str, float] = {}
    for when, version, _ in chat:
        first.setdefault(version, when)
    versions = tuple(first)
    gaps, late = [], 0
    for old, new in itertools.pairwise(versions):
        of_old = [when for when, version, _ in chat if version == old]
        late += sum(when > first[new] for when in of_old)
        gaps.append(first[new] - max(when for when in of_old if when <= first[new]))
    numbers = {version: [n for _, v, n in chat if v == version] for version in versions}
    twice = sum(len(_twice(found)) for found in numbers.values())
    missing = sum(len(_holes(found)) for found in numbers.values())
    return versions, tuple(gaps), twice, late, missing


def _numbers(handled: Iterable[Sequence[str]], kind: str) -> list[int]:
    return [int(words[3]) for words in handled if words[2] == kind]


def _twice(numbers: Iterable[int]) -> tuple[int, ...]:
    return tuple(sorted(number for number, times in Counter(numbers).items() if times > 1))


def _holes(numbers: Sequence[int]) -> tuple[int, ...]:
    """Return the numbers between the smallest and the largest that are not there."""
    there = set(numbers)
    return tuple(n for n in range(min(there), max(there)) if n not in there) if there else ()

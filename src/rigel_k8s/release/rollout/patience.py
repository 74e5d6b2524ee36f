"""How long a cause may last before a roll-out is given up; pure: the time is passed in.

A cause is reported when it is seen. Giving up takes longer: registries fail for a moment,
autoscalers add machines, and a ROS node that ends because there is no master yet is started again.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator

import attrs

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout.causes import Cause


@attrs.frozen
class Patience:
    """Seconds that each kind of cause may last.

    Attributes:
        crash: counted while nothing else of the release is still starting; what then ends with the
            same last words was not what this one has waited for.
        crash_limit: counted from the first crash, whatever else happens.
        away: a robot may return at any time; the roll-out's own deadline is the limit.
    """

    image: float = 15.0
    image_name: float = 0.0
    start: float = 15.0
    crash: float = 20.0
    crash_limit: float = 120.0
    unschedulable: float = 90.0
    claim: float = 60.0
    quota: float = 15.0
    mount: float = 45.0
    path: float = 15.0
    sandbox: float = 60.0
    evicted: float = 30.0
    failed: float = 0.0
    away: float = math.inf

    def of(self, kind: str) -> float:
        """Return the seconds for a kind of cause."""
        return float(getattr(self, kind.replace("-", "_")))


@attrs.define
class Seen:
    """A cause of a workload since it was first seen.

    Attributes:
        lines: what is reported of it if it passes; none if it has been reported.
    """

    ref: ObjectRef
    cause: Cause
    since: float
    lines: list[str] = attrs.field(factory=list)


@attrs.define
class Ledger:
    """The present causes, and since when.

    `refs` are the workloads that have one, `busy` is when each of the others was last on its way.
    """

    patience: Patience
    seen: dict[tuple[ObjectRef, tuple[str, str]], Seen] = attrs.field(factory=dict)
    busy: dict[ObjectRef, float] = attrs.field(factory=dict)
    refs: frozenset[ObjectRef] = frozenset()

    def note(
        self,
        now: float,
        current: Iterable[tuple[ObjectRef, Cause]],
        *,
        coming: Collection[ObjectRef] = (),
        unsteady: Collection[ObjectRef] = (),
    ) -> tuple[list[Seen], list[Seen]]:
        """Note the present causes; return the new ones, and those that have passed.

        Args:
            coming: workloads that are not ready, and nothing is wrong with them.
            unsteady: those that run at the moment and have crashed before: what was wrong with them
                still counts.
        """
        self.busy |= dict.fromkeys(coming, now)
        found = {(ref, cause.key): (ref, cause) for ref, cause in current}
        fresh, passed = [], []
        for key, (ref, cause) in found.items():
            if key in self.seen:
                self.seen[key].cause = cause
            else:
                self.seen[key] = Seen(ref, cause, now)
                fresh.append(self.seen[key])
        for key, seen in list(self.seen.items()):
            if key not in found and seen.ref not in unsteady:
                passed.append(self.seen.pop(key))
            elif key not in found:
                seen.cause = attrs.evolve(seen.cause, kind="restarted")
        self.refs = frozenset(seen.ref for seen in self.seen.values())
        return fresh, passed

    def of(self, ref: ObjectRef) -> list[Seen]:
        """Return the causes of one workload."""
        return [seen for seen in self.seen.values() if seen.ref == ref]

    def find_hopeless(self, now: float) -> Iterator[Seen]:
        """Yield the causes that have lasted too long."""
        for seen in self.seen.values():
            if seen.cause.kind == "restarted":  # it runs at the moment, and may get ready
                continue
            if seen.cause.kind == "crash":
                limit = seen.since + self.patience.crash_limit
                begin = max(seen.since, self.find_busy(seen.cause))
                over = now >= min(limit, begin + self.patience.crash)
            else:
                over = now >= seen.since + self.patience.of(seen.cause.kind)
            if over:
                yield seen

    def find_busy(self, crash: Cause) -> float:
        """Return when a workload that has not crashed in the same way was last on its way.

        An exit code alone, without last words, may have any cause.
        """
        alike = {
            seen.ref
            for seen in self.seen.values()
            if seen.cause.kind == "crash" and seen.cause.message == crash.message != crash.brief
        }
        return max((time for ref, time in self.busy.items() if ref not in alike), default=0.0)

"""Which revision a rollback goes back to, and what its result is called.

The next rollback finishes an interrupted one. So it must not take the interrupted one's target for
the present state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias, TypeVar

from rigel_k8s.errors import Interrupted, RigelK8sError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.release import revisions
from rigel_k8s.release.locking import is_alive, lease_ref
from rigel_k8s.release.part import Run, WayBack
from rigel_k8s.release.types import DeployOptions, ReleaseId, Revision
from rigel_k8s.report import Reporter

Failure = TypeVar("Failure", bound=RigelK8sError)
RollBack: TypeAlias = Callable[[Cluster, ReleaseId, int, DeployOptions], Revision]


def choose_target(
    cluster: Cluster, release: ReleaseId, number: int | None, report: Reporter
) -> Revision:
    """Return the revision to deploy again.

    Args:
        number: None is the target of a rollback that was interrupted, else the last good revision
            before the present.

    Raises:
        UserError: it does not exist.
    """
    records = revisions.records(cluster, release)
    unfinished = None if number is not None else find_unfinished(cluster, release, records)
    if unfinished is not None:
        report.line(
            f"{release.namespace}/{release.name}: the rollback to revision {unfinished.back_to} was"
            f" interrupted (revision {unfinished.number}); finishing it"
        )
        done = unfinished.status == "good"
        number = unfinished.number if done else unfinished.back_to
    return choose_record(records, release, number).revision()


def find_target(cluster: Cluster, release: ReleaseId) -> int | None:
    """Return the revision that a failed deploy can return to, None if none was good."""
    records = revisions.records(cluster, release)
    good = [record.number for record in records if record.status == "good"]
    return good[-1] if good and records[-1].status != "good" else None


def undo(run: Run, failure: Failure, back: WayBack, roll_back: RollBack) -> Failure:
    """Go back after a failure; return the failure with the result of that.

    A first deploy has nothing to go back to, and stays as it was applied.

    Args:
        roll_back: rigel_k8s.deploy.roll_back.

    Raises:
        Interrupted: `options.cancel` was set.
    """
    kind, why, details = type(failure), failure.message, failure.details
    if back.number is None:
        left = "there is no earlier good revision to go back to, so it is left as it is"
        return kind(f"{why}; {left}", hint=failure.hint, details=details)
    run.report.warn(f"rolling back to revision {back.number}")
    try:
        made = roll_back(run.cluster, run.release, back.number, run.options)
    except Interrupted:  # its error does not have the failure
        run.report.warn("\n".join([why, *details]))
        raise
    except RigelK8sError as error:
        look, again = (
            run.options.write_command(one, run.release) for one in ("status", "rollback")
        )
        return kind(
            f"{why}, and it cannot be rolled back to revision {back.number}: {error.message}",
            hint=f"{look} shows what runs; {again} tries again",
            details=[*details, *error.details],
        )
    return kind(
        f"{why}: rolled back to revision {back.number}, as revision {made.number}",
        hint=back.hint,
        details=details,
    )


def find_unfinished(
    cluster: Cluster, release: ReleaseId, records: Sequence[revisions.Record]
) -> revisions.Record | None:
    """Return the record of an interrupted rollback, None without one.

    It is the last one and has not ended; or it is good, and the process that wrote it was killed
    before it could release its Lease: its user has not seen that it was done.
    """
    last = records[-1] if records else None
    if last is None or last.back_to is None:
        return None
    if last.status in ("pending", "interrupted"):
        return last
    lease = cluster.get(lease_ref(release)) if last.status == "good" else None
    return last if lease is not None and is_alive(lease) is not True else None


def choose_record(
    records: Sequence[revisions.Record], release: ReleaseId, number: int | None
) -> revisions.Record:
    """Return the record to roll back to."""
    good = [record for record in records[:-1] if record.status == "good"]
    if number is None and good:
        return good[-1]
    found = [record for record in records if record.number == number]
    if found:
        return found[0]
    what = f"no revision {number}" if number is not None else "no good revision before the last"
    raise no_revision_error(records, release, what)


def no_revision_error(
    records: Sequence[revisions.Record], release: ReleaseId, what: str
) -> UserError:
    numbers = ", ".join(str(record.number) for record in records) or "none"
    return UserError(f"{release.name} has {what}", hint=f"see `rigel history`; kept: {numbers}")

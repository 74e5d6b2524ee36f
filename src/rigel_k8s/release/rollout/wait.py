"""Wait until what was applied is ready, or report why it will not be; it writes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from rigel_k8s.errors import Interrupted, RolloutFailed
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.overlay import pod_of
from rigel_k8s.objects.refs import Manifest, ref_of
from rigel_k8s.release.part import Look, Run
from rigel_k8s.release.revisions import find_good
from rigel_k8s.release.rollout.account import Account
from rigel_k8s.release.rollout.patience import Ledger
from rigel_k8s.release.rollout.standing import Standing
from rigel_k8s.release.rollout.unprobed import LogWatch
from rigel_k8s.release.rollout.view import EVENT, POD, REPLICA_SET, Related, ReleaseView
from rigel_k8s.release.types import WORKLOADS, Revision

LOOK = 0.25  # seconds between two looks at the clock
SOON = 0.05  # the same when only logs are waited for
BRIEF = 0.01  # seconds of a look after which the next one may follow at once
REST = 3  # pause, in durations of a look: a core is left for others
EXPLAIN = 0.5  # seconds between two searches for causes
QUIET = 2.0  # seconds without events: a quick roll-out needs none
BEHIND = 2.0  # seconds by which one watch may be behind another
SPARE = 600.0  # seconds that outages of the API server may prolong a wait


def wait(run: Run, applied: Iterable[Manifest], good: int, still_ours: Callable[[], None]) -> None:
    """Return when all workloads that were applied are ready.

    Args:
        good: the revision before, which became ready; 0 for none.
        still_ours: raises if the deploy must not continue (its Lease is lost).

    Raises:
        RolloutFailed: something will not become ready, or not within the time.
        Interrupted: `cancel` was set.
    """
    targets = {ref_of(live): live for live in applied if live["kind"] in WORKLOADS}
    standing = Standing(targets, frozenset(run.part.away))
    account = Account(run, standing, good, Ledger(run.patience))
    standing.look(targets, Related(), time.monotonic())
    account.show_states()
    if not standing.list_waiting():
        return
    spaces = {ref.namespace for ref in targets}
    where = spaces.pop() if len(spaces) == 1 else ""
    view, logs = ReleaseView(run.cluster, where, run.options.limit + SPARE), LogWatch(run.cluster)
    with view, logs:
        own = f"{RELEASE_LABEL}={run.release.name}"
        kinds = {(ref.api_version, ref.kind) for ref in targets}
        view.watch([*sorted(kinds), REPLICA_SET, POD], labels=own)
        try:
            follow(run, view, logs, account, still_ours)
        except RolloutFailed:  # it names all causes
            account.ledger.seen.clear()
            raise
        finally:
            account.warn(account.ledger.seen.values())


def wait_settled(run: Run, seen: Look, last: Revision) -> Revision:
    """Return the last revision, which is as desired, when all of it is ready. Raises as wait."""
    run.part.hooks.stored()
    live = [step.live for step in seen.plan.steps if step.action == "keep" and step.live]
    wait(run, live, find_good(seen.survey.history), lambda: None)
    if run.part.back_to not in (None, last.number):
        text = f"nothing to change: revision {last.number} is as revision {run.part.back_to} was"
        run.report.line(text)
    return last


def follow(
    run: Run,
    view: ReleaseView,
    logs: LogWatch,
    account: Account,
    still_ours: Callable[[], None],
) -> None:
    """Look again and again until all is ready; raises as `wait`."""
    standing, cancel = account.standing, run.options.cancel
    started, explained = time.monotonic(), 0.0
    seen, turns = started, allow_turns(standing.targets.values())
    # What is unreachable cannot become ready: that time does not count.
    deadline = started + run.options.limit - run.cluster.sum_outages()
    while True:
        now = time.monotonic()
        live = {ref: there for ref in standing.targets if (there := view.find(ref)) is not None}
        standing.look(live, view.find_related(), now)
        account.show_states()
        if turns > 0 and any(map(standing.find_turn, standing.list_waiting())):
            deadline, turns = deadline + now - seen, turns - (now - seen)
        seen = now
        last = standing.is_enough(now) and sees_pods(view, standing, now)
        if all_run(standing, logs, now, last=last):
            account.leave_behind()
            return
        still_ours()
        if now - started > QUIET:
            view.watch([EVENT], fields="type=Warning")
        if now - explained >= EXPLAIN:
            explained = now
            account.note_causes(now)
        if now > deadline + run.cluster.sum_outages() and standing.enough_since is None:
            raise account.timeout_error()
        if cancel.is_set():
            raise Interrupted(
                f"interrupted while {run.release.name} was rolling out: "
                "the cluster continues the roll-out",
                hint="run the same command again to wait for it;"
                f" {run.choose_way_out(account.good)}",
            )
        spent = time.monotonic() - now
        if spent > BRIEF:  # events gather: the next look handles all of them
            cancel.wait(min(LOOK, REST * spent))
        view.refresh(SOON if last else LOOK)


def allow_turns(targets: Iterable[Manifest]) -> float:
    """Return how many seconds pods may wait to take over: as long as the old ones may take to end.

    What the old ones have begun is no fault of the roll-out, so that time does not count.
    """
    pods = [pod_of(target) for target in targets]
    return max((float(pod.get("terminationGracePeriodSeconds", 0)) for pod in pods), default=0)


def sees_pods(view: ReleaseView, standing: Standing, now: float) -> bool:
    """Whether pods of all that is ready were seen: each kind has a watch, and they keep no order.

    Without them, a crash before the pod was ready would be missed. They come at once, or never.
    """
    if standing.enough_since is not None and now - standing.enough_since >= BEHIND:
        return True
    return view.complete and (REPLICA_SET in view.refused or not standing.list_unseen())


def all_run(standing: Standing, logs: LogWatch, now: float, *, last: bool) -> bool:
    """Whether containers without probes really run; they are looked at until all else is ready."""
    ready = standing.list_unprobed()
    ended = logs.look(ready, now, last=last)
    for ref in ended:
        standing.crashes.note_end(ref, now)
    return last and not ended and logs.is_sure_of(ready)

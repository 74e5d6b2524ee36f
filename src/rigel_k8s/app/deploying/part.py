"""An application as a part of a job: its own hooks, and those of guests."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Event

import attrs

from rigel_k8s.app.deploying.guests import Guest
from rigel_k8s.app.deploying.images import write_pull_secret
from rigel_k8s.app.deploying.prepare import Preparation
from rigel_k8s.app.deploying.results import copy_results
from rigel_k8s.errors import Interrupted, RigelK8sError, RolloutFailed
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.release.part import Hooks, Inspection, Look, Run, WayBack
from rigel_k8s.release.rollback import find_target
from rigel_k8s.release.types import Plan, Revision
from rigel_k8s.settings import Application, Settings

#: The hint after a rollback because it did not become ready.
CORRECT = "fix the cause, then run it again"


@attrs.define(kw_only=True)
class ApplicationHooks(Hooks):
    """Around an application: its pull secret before, its results after; and what guests do.

    Attributes:
        applied: set when its objects are stored, before they are waited for.
        guests: look at the cluster, too, before anything is written.
        beside: the hooks of guests.
    """

    prepared: Preparation
    application: Application
    settings: Settings
    applied: Event
    guests: Sequence[Guest] = ()
    beside: Sequence[Hooks] = ()

    def inspect(self, cluster: Cluster, earlier: Sequence[Look]) -> Inspection:
        """Return what keeps it from working on this cluster, or may."""
        mended = any(one.part.rank == "network" and one.writes for one in earlier)
        options, objects = self.prepared.options, self.prepared.desired.objects
        looks = (one.inspect(objects, options, cluster, mended=mended) for one in self.guests)
        seen = list(filter(None, looks))
        return Inspection(
            [error for one in seen for error in one.errors],
            [warning for one in seen for warning in one.warnings],
        )

    def before_write(self, run: Run, seen: Look) -> None:
        """Write the Secret with which its images are pulled."""
        write_pull_secret(run.desired, self.prepared.credentials, run.cluster)

    def before_pods(self, run: Run, plan: Plan) -> None:
        """Let guests look at the robot as it was."""
        for one in self.beside:
            one.before_pods(run, plan)

    def stored(self) -> None:
        """Let what waits for the objects go on."""
        self.applied.set()
        for one in self.beside:
            one.stored()

    def verify(self, run: Run) -> None:
        """Let guests refuse the update."""
        for one in self.beside:
            one.verify(run)

    def way_back(self, run: Run, failure: RigelK8sError) -> WayBack | None:
        """Return the revision before, if a guest or the user requests a rollback."""
        for one in self.beside:
            if way := one.way_back(run, failure):
                return way
        if isinstance(failure, RolloutFailed) and self.settings.rollback_on_failure:
            return WayBack(find_target(run.cluster, run.release), CORRECT)
        return None

    def after_write(self, run: Run, revision: Revision | None, seen: Look) -> None:
        """Report its revision, and what guests have seen of the update."""
        if revision is not None:
            run.report.line(f"{run.where} is at revision {revision.number}")
        for one in self.beside:
            one.after_write(run, revision, seen)

    def watch(self, run: Run) -> None:
        """Let guests watch the robot, then copy the results."""
        for one in self.beside:
            one.watch(run)
        results = self.prepared.options.results
        if results is None:
            return
        target = self.application.dir / results.target
        try:
            copied = copy_results(results, run.release, run.cluster, target, run.options.cancel)
        except RigelK8sError as error:
            if results.wait is not None or isinstance(error, Interrupted):
                raise
            run.report.warn(f"{error.message}; `results: {{wait: 1m}}` would wait for them")
        else:
            run.report.line(f"results copied to {copied}")

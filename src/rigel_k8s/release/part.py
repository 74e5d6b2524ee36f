"""What one job deploys, as data: a part for each release, a look at it, and a run of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeAlias

import attrs

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.problems import Problem
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.survey import Survey
from rigel_k8s.release.types import DeployOptions, Desired, Plan, ReleaseId, Revision
from rigel_k8s.report import Reporter

#: When a part is written: pods need the network, and robots do not wait for dashboards.
Rank: TypeAlias = Literal["network", "application", "stack"]
RANKS: Sequence[Rank] = ("network", "application", "stack")


@attrs.frozen
class Inspection:
    """Why a part cannot work, and why it may not."""

    errors: Sequence[RigelK8sError] = ()
    warnings: Sequence[str] = ()


@attrs.frozen
class WayBack:
    """A rollback after a failure: to which revision (None: no earlier one is good), and a hint."""

    number: int | None
    hint: str


class Hooks:
    """What only the builder of a part knows. A deploy calls these, in this order; here none acts.

    Any of them may raise: before the first write nothing is changed then, later the deploy has
    failed.
    """

    def inspect(self, cluster: Cluster, earlier: Sequence[Look]) -> Inspection:
        """Return what keeps the part from working; only read. Called beside the dry runs.

        Args:
            earlier: what will be written before it.
        """
        return Inspection()

    def before_write(self, run: Run, seen: Look) -> None:
        """Write what objects of the part need and no revision has: Secrets with passwords."""

    def before_pods(self, run: Run, plan: Plan) -> None:
        """Look at the running robot. The Lease is held; pods are still the old ones."""

    def stored(self) -> None:
        """Take note that all objects are stored, and only the wait for them remains."""

    def verify(self, run: Run) -> None:
        """Raise if the revision, of which all is ready, is a failed one nevertheless."""

    def way_back(self, run: Run, failure: RigelK8sError) -> WayBack | None:
        """Return where a failed deploy goes back to; None to leave it as it is."""
        return None

    def after_write(self, run: Run, revision: Revision | None, seen: Look) -> None:
        """Report the part's state.

        Args:
            revision: its last one; None where others have installed it.
            seen: as it was before.
        """

    def watch(self, run: Run) -> None:
        """Look at the running robot, once all parts are written."""


@attrs.define(kw_only=True)
class Part:
    """One release that a job deploys.

    Attributes:
        rank: when it is written.
        own: it is what the job is about. Otherwise others may have installed it: it is left out
            with a warning where rights for it are missing.
        needed: the job fails with it. Otherwise its failure is only a warning.
        shared: all applications of a cluster use it: it is not waited for if it is as it was left.
        foreign: others have installed it: nothing of it is compared or written.
        unfinished: its hooks have something to do even if no object of it changes.
        adopt: it may take over objects and fields of others if the user requests that.
        away: machines that do not answer, and are not waited for: their pods come with them.
        timeout: seconds that its roll-out may take, if the user does not set them.
        back_to: the revision that it deploys again; None for a deploy.
        keep: objects that stay although it does not describe them.
        hint: what to do without the rights for it.
        place: turns problems with the options into texts with their lines in the Rigelfile.
    """

    desired: Desired
    rank: Rank = "application"
    own: bool = True
    needed: bool = True
    shared: bool = False
    foreign: bool = False
    unfinished: bool = False
    adopt: bool = True
    away: tuple[str, ...] = ()
    timeout: float | None = None
    back_to: int | None = None
    keep: frozenset[ObjectRef] = frozenset()
    hint: str = ""
    place: Callable[[Sequence[Problem]], Sequence[str]] = lambda found: [p.message for p in found]
    hooks: Hooks = attrs.field(factory=Hooks)

    @property
    def release(self) -> ReleaseId:
        return self.desired.release


@attrs.frozen
class Look:
    """A part, the cluster as it is for it, and what will be done there.

    Attributes:
        found: None for what others have installed.
        settled: the last revision, if it is good and as desired, and the cluster matches it.
    """

    part: Part
    found: Survey | None
    plan: Plan
    settled: Revision | None = None
    warnings: Sequence[str] = ()

    @property
    def survey(self) -> Survey:
        """What was found of a part that is ours to write."""
        if self.found is None:
            raise AssertionError("what others have installed is not written")
        return self.found

    @property
    def writes(self) -> bool:
        """Whether anything will be done to it, beside a wait."""
        if self.part.unfinished:
            return True
        if self.part.shared and self.found is not None:
            return self.settled is None
        return bool(self.plan.changes)


@attrs.frozen(kw_only=True)
class Run:
    """What is deployed, where and how."""

    cluster: Cluster
    part: Part
    options: DeployOptions
    patience: Patience = attrs.field(factory=Patience)

    @classmethod
    def of_objects(
        cls, cluster: Cluster, release: ReleaseId, options: DeployOptions, *objects: Manifest
    ) -> Run:
        """Return one of some objects of a release, outside of a deploy of all of them."""
        return cls(cluster=cluster, part=Part(desired=Desired(release, objects)), options=options)

    @property
    def desired(self) -> Desired:
        return self.part.desired

    @property
    def release(self) -> ReleaseId:
        return self.part.release

    @property
    def report(self) -> Reporter:
        return self.options.report

    @property
    def where(self) -> str:
        """The release, for messages."""
        return f"{self.release.name} in {self.release.namespace}"

    def choose_way_out(self, good: int) -> str:
        """Return what else to do after it has failed or was interrupted, as a sentence.

        Args:
            good: the newest revision that became ready, 0 for none.
        """
        if self.part.back_to is None and good:
            command = self.options.write_command("rollback", self.release)
            return f"{command} goes back to revision {good}"
        return f"{self.options.write_command('status', self.release)} shows its state"


def order(parts: Iterable[Part]) -> list[Part]:
    return sorted(parts, key=lambda part: RANKS.index(part.rank))


def if_allowed(build: Callable[[], Part], name: str, report: Reporter) -> list[Part]:
    """Return a part that others may have installed; without the rights to look at it, none."""
    try:
        return [build()]
    except Forbidden as error:
        if error.ground != "right":
            raise
        warn_of_rights(error, name, report)
        return []


def warn_of_rights(error: Forbidden, name: str, report: Reporter) -> None:
    """Report that a part is left out."""
    report.warn(f"{error.message}: {name} stays as it is; {error.hint}")

"""All that one job deploys, as one: look at every part, refuse all at once, write in order, watch.

A job's parts are releases: what the network needs, an application, the observability stack. Nothing
of any part is written while another would be refused. The network is written first, since pods need
it; the stack last, since robots do not wait for dashboards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Literal, TypeAlias

import attrs

from rigel_k8s.errors import ClusterError, Interrupted, RigelK8sError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.problems import Problem
from rigel_k8s.release.deploy import Look, deploy_release, is_settled, look
from rigel_k8s.release.drift import describe_drift
from rigel_k8s.release.labelling import manifests_to_apply
from rigel_k8s.release.locking import bury
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.run import Run
from rigel_k8s.release.types import DeployOptions, Desired, Plan, ReleaseId, Revision
from rigel_k8s.report import Reporter

Rank: TypeAlias = Literal["network", "application", "stack"]
RANKS: Sequence[Rank] = ("network", "application", "stack")


@attrs.define(kw_only=True)
class Part:
    """One release that a job deploys; what only its builder knows is in the methods of subclasses.

    Attributes:
        rank: when it is written.
        own: it is what the job is about. Otherwise others may have installed it: it is left out
            with a warning where rights for it are missing.
        needed: the job fails with it. Otherwise its failure is only a warning.
        adopt: it may take over objects and fields of others if the user requests that.
        hint: what to do without the rights for it.
        place: turns problems with the options into texts with their lines in the Rigelfile.
    """

    desired: Desired
    rank: Rank = "application"
    own: bool = True
    needed: bool = True
    adopt: bool = True
    hint: str = ""
    place: Callable[[Sequence[Problem]], Sequence[str]] = lambda found: [p.message for p in found]

    @property
    def release(self) -> ReleaseId:
        """Its release."""
        return self.desired.release

    def look(self, cluster: Cluster, *, adopt: bool) -> Look:
        """Return what would be done. Raises if it would be refused."""
        return look(cluster, self.desired, adopt=adopt)

    def inspect(self, cluster: Cluster, earlier: Sequence[PartLook]) -> Inspection:
        """Return what keeps it from working that release/ cannot know; only reads.

        Args:
            earlier: what will be written before it.
        """
        return Inspection()

    def changes(self, looked: Look) -> bool:
        """Whether `write` does more than to wait."""
        return bool(looked.plan.changes)

    def write(self, cluster: Cluster, looked: Look, options: DeployOptions) -> None:
        """Deploy it, and wait until it is ready. Raises as release.deploy."""
        deploy_release(Run(cluster=cluster, desired=self.desired, options=options), looked)

    def watch(self, cluster: Cluster, options: DeployOptions) -> None:
        """Look at it after all parts were written."""


@attrs.define(kw_only=True)
class SharedPart(Part):
    """A release that all applications of a cluster share, with a pod on each machine.

    Nothing is written, and nothing is waited for, if it is as it was left.

    Attributes:
        away: machines that do not answer: their pods come with them.
    """

    away: tuple[str, ...] = ()

    def changes(self, looked: Look) -> bool:
        """Whether something differs, or its last installation was another or did not end well.

        The revisions may have been read before another deploy began and the objects after it wrote
        them: so the last revision's objects are compared as well.
        """
        return not is_settled(looked)

    def warn_of_away(self, report: Reporter) -> None:
        """Report the machines that are not waited for."""
        for name in self.away:
            report.warn(f"machine {name} is not ready: the installation does not wait for it")

    def install(self, cluster: Cluster, looked: Look, options: DeployOptions) -> Revision:
        """Deploy it, unless it is as it was left; return its last revision."""
        last = looked.survey.last
        if last is not None and not SharedPart.changes(self, looked):
            if looked.survey.lease is not None:
                bury(cluster, looked.survey.lease, options.report)
            return last
        run = Run(
            cluster=cluster,
            desired=self.desired,
            options=options,
            away=frozenset(self.away),
        )
        return deploy_release(run, looked)


@attrs.frozen
class Inspection:
    """What a part's own inspection finds."""

    errors: Sequence[RigelK8sError] = ()
    warnings: Sequence[str] = ()


@attrs.frozen
class PartLook:
    """A part, the cluster as it is for it, and what will be done there."""

    part: Part
    looked: Look
    warnings: Sequence[str] = ()

    @property
    def plan(self) -> Plan:
        """What will be done."""
        return self.looked.plan

    @property
    def writes(self) -> bool:
        """Whether anything will be written."""
        return self.part.changes(self.looked)


def order(parts: Iterable[Part]) -> list[Part]:
    """Return parts in the order in which they are written."""
    return sorted(parts, key=lambda part: RANKS.index(part.rank))


def render(parts: Iterable[Part]) -> tuple[Manifest, ...]:
    """Return the manifests that apply would send."""
    return tuple(item for part in order(parts) for item in manifests_to_apply(part.desired))


def look_at(parts: Iterable[Part], cluster: Cluster, options: DeployOptions) -> list[PartLook]:
    """Return what would be done, in order; nothing is written.

    Raises:
        RigelK8sError: all reasons for which it would be refused, in one error.
    """
    errors: list[RigelK8sError] = []
    looks: list[PartLook] = []
    for part in order(parts):
        try:
            looks.append(look_at_part(part, cluster, options, looks))
        except Forbidden as error:
            if error.ground != "right" or part.own:
                errors.append(error)
            else:
                warn_of_rights(error, part.release.name, options.report)
        except Interrupted:
            raise
        except (UserError, ClusterError) as error:
            errors.append(error)
    if errors:
        raise combine(errors)
    return looks


def look_at_part(
    part: Part, cluster: Cluster, options: DeployOptions, earlier: Sequence[PartLook] = ()
) -> PartLook:
    """Return what would be done for one part. Raises if it would be refused."""
    errors: list[RigelK8sError] = []
    found: list[Look] = []
    inspections: list[Inspection] = []
    part.desired = attrs.evolve(part.desired, defined=frozenset(list_defined(earlier)))

    def survey() -> None:
        try:
            found.append(part.look(cluster, adopt=options.adopt and part.adopt))
        except Forbidden as error:
            if error.ground == "right" and part.hint:
                error.hint = part.hint
            errors.append(error)
        except Refused as refused:
            refused.details = tuple(part.place(refused.problems))
            errors.append(refused)
        except Interrupted:
            raise
        except (UserError, ClusterError) as error:
            errors.append(error)

    def inspect() -> None:
        inspections.append(part.inspect(cluster, earlier))

    cluster.parallel(lambda call: call(), [survey, inspect])
    [inspection] = inspections
    errors += inspection.errors
    if errors:
        raise combine(errors)
    [looked] = found
    drift = [] if options.adopt and part.adopt else list_drift(looked.plan)
    return PartLook(part, looked, (*inspection.warnings, *drift))


def list_drift(plan: Plan) -> list[str]:
    """Return what others have added to a release's objects, which a deploy leaves there."""
    return [
        f"{step.ref.kind} {step.ref.name} {text}; --adopt undoes it"
        for step in plan.steps
        if step.live and step.manifest
        for text in describe_drift(step.live)
    ]


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


def list_defined(looks: Iterable[PartLook]) -> Iterator[tuple[str, str]]:
    """Yield the kinds that some parts define, each with its group."""
    for manifest in (item for one in looks for item in one.part.desired.objects):
        if manifest["kind"] == "CustomResourceDefinition":
            yield manifest["spec"]["group"], manifest["spec"]["names"]["kind"]


def deploy(parts: Iterable[Part], cluster: Cluster, options: DeployOptions) -> None:
    """Deploy all that a job describes.

    Raises:
        RigelK8sError: it would be refused, for these reasons; nothing was written.
        ClusterError, RolloutFailed: something went wrong; the causes are in the details.
        Interrupted: `options.cancel` was set.
    """
    looks = look_at(parts, cluster, options)
    warned: set[str] = set()
    written = False
    for one in looks:
        part = one.part
        try:
            if written:  # the cluster has changed since
                one = look_at_part(part, cluster, options)
            for warning in one.warnings:
                if warning not in warned:
                    options.report.warn(warning)
            warned.update(one.warnings)
            part.write(
                cluster, one.looked, attrs.evolve(options, adopt=options.adopt and part.adopt)
            )
        except Interrupted:
            raise
        except RigelK8sError as error:
            if part.needed:
                raise
            text = f"{error.message}; everything else is deployed"
            options.report.warn("\n".join([text, *error.details]))
        written = written or one.writes
    for one in looks:
        one.part.watch(cluster, options)


def combine(errors: Iterable[RigelK8sError]) -> RigelK8sError:
    """Return one error for several, each of them once."""
    several = list({error.message: error for error in errors}.values())
    if len(several) == 1:
        return several[0]
    kind = UserError if any(isinstance(one, UserError) for one in several) else ClusterError
    details = []
    for one in several:
        details += [one.message, *(f"    {line}" for line in (*one.details, one.hint) if line)]
    return kind(
        f"{len(several)} things keep this job from being deployed; nothing was changed",
        details=details,
    )

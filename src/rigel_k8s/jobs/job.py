"""The interface between a sequence and its jobs; independent of job types."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import attrs

from rigel_k8s import report
from rigel_k8s.problems import Problem
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.settings import Application, Settings

O_contra = TypeVar("O_contra", contravariant=True)  # the options of a job type or provider


class JobReporter(report.Reporter, Protocol):
    """Where a job reports its progress. The command line implements it; jobs never print."""

    def child(self, name: str) -> JobReporter:
        """Return a reporter for a part (a job, a parallel branch) that runs next to others."""


@attrs.frozen
class JobContext:
    """What a running job may use.

    Attributes:
        name: the job's key in the Rigelfile.
        application: the Rigelfile's application.
        data: what earlier jobs of the sequence stored (`{{ data.x }}`); this job stores there too.
        vars: the Rigelfile's `vars` as plain data, templates rendered.
        providers: connections of the Rigelfile's providers, by key.
        report: where to report progress.
        cancel: set when the job must stop: end soon, and report what is left half done.
        settings: the command line's global options.
        raw: the job's `with` as plain data, templates rendered, before it became options.
        serving: the job is a dependency of a concurrent stage: it serves until `cancel` is set.
        ready: a serving job sets it when others may use it (not needed if it returns).
        applied: a job that deploys sets it when its objects are stored, before it waits for them.
        place: turns problems with the options into texts with their lines in the Rigelfile.
        dry: the job is only looked at (`render`, `diff`): providers are not connected.
    """

    name: str
    application: Application
    report: JobReporter
    settings: Settings = attrs.field(factory=Settings)
    data: MutableMapping[str, Any] = attrs.field(factory=dict)
    vars: Mapping[str, Any] = attrs.field(factory=dict)
    providers: Mapping[str, Any] = attrs.field(factory=dict)
    cancel: threading.Event = attrs.field(factory=threading.Event)
    raw: Mapping[str, Any] = attrs.field(factory=dict)
    serving: bool = False
    ready: threading.Event = attrs.field(factory=threading.Event)
    applied: threading.Event = attrs.field(factory=threading.Event)
    place: Callable[[Sequence[Problem]], Sequence[str]] = lambda found: list(map(str, found))
    dry: bool = False

    @property
    def deploy_options(self) -> DeployOptions:
        """How this job deploys."""
        name = self.settings.description or self.name
        options = DeployOptions.of(self.settings, self.report, self.cancel, name)
        varies = bool(self.data or self.settings.namespace)
        return attrs.evolve(options, names_release=varies)


@attrs.frozen
class JobOptions:
    """A job's options when it runs, checked.

    Attributes:
        raw: the job's `with` as plain data, templates rendered.
        warnings: of their check, rendered.
        place: turns problems with them into texts with their lines in the Rigelfile.
    """

    options: Any
    raw: Mapping[str, Any]
    warnings: Sequence[str] = ()
    place: Callable[[Sequence[Problem]], Sequence[str]] = lambda found: list(map(str, found))


class JobType(Protocol[O_contra]):
    """One kind of job. `options` is an attrs class; unknown keys are refused by its fields' names.

    `run` returns when the work is done and raises a RigelK8sError if it fails. A job that serves
    others (a dependency of a concurrent stage, `job.serving`) sets `job.ready` when they may use it
    and runs until `job.cancel` is set; one whose effect lasts without it just returns.

    A job type may have `needs_cluster`: True if `run` connects to the cluster of the settings,
    False if it neither does so nor creates one. Without it, the type may create one. What else it
    may do: the classes below, and those of deploying.py and rigelfile/options.py.
    """

    options: ClassVar[type[Any]]

    def check(self, options: O_contra, application: Application) -> Sequence[Problem]:
        """Return what is wrong with the options beyond their types; pure."""

    def run(self, options: O_contra, job: JobContext) -> None:
        """Do the work."""


@runtime_checkable
class Exclusive(Protocol[O_contra]):
    """A job type whose jobs must not do some things at the same time."""

    def exclusive(
        self, options: O_contra, application: Application, settings: Settings
    ) -> str | None:
        """Return a key for that, such as the release to deploy or the file to write, or None."""


@runtime_checkable
class HasWorkloads(Protocol[O_contra]):
    """A job type for an application; its jobs are meant where a command names none."""

    def workloads(self, options: O_contra, application: Application) -> Sequence[str]:
        """Return the names of the nodes and other workloads."""


class ProviderType(Protocol[O_contra]):
    """One kind of provider: something connected before a sequence and disconnected after it."""

    options: ClassVar[type[Any]]

    def check(self, options: O_contra, application: Application) -> Sequence[Problem]:
        """Return what is wrong with the options beyond their types; pure."""

    def connect(self, options: O_contra, name: str, report: JobReporter) -> Any:
        """Connect and return what jobs get as `job.providers[name]`."""

    def disconnect(self, connection: Any) -> None:
        """Undo connect; called on success, failure and interruption."""

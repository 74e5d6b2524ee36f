"""The parts of a deploy, as plain data; no I/O here."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, TypeAlias

import attrs

from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.problems import Path
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings

DEFAULT_TIMEOUT = 300.0  # seconds of a roll-out


@attrs.frozen
class ReleaseId:
    """(namespace, deployment_name): what two jobs of one application share."""

    namespace: str
    name: str


@attrs.frozen
class Obstacle:
    """Why an object would not do its work although the API server accepts it.

    Attributes:
        ground: a short slug, by which `Desired.remedies` has a way out.
    """

    ref: ObjectRef
    text: str
    ground: str


#: Finds obstacles of workloads, given their manifests and the cluster's machines.
Inspect: TypeAlias = Callable[[Sequence[Manifest], Sequence[Manifest]], Iterable[Obstacle]]


@attrs.frozen
class Desired:
    """The desired state of a release.

    Attributes:
        objects: complete manifests, namespaced ones with their namespace; no Namespace.
        origins: the path in the job's options that each object came from.
        options: the options as plain data, kept in the revision: a partial job is laid over them.
        create_namespace: whether a missing namespace is created (the Rigelfile names it).
        protected: objects that outlive `down` unless volumes are requested (claims and volumes).
        remedies: by kind of object: what to do if the right to write one is missing; by ground of
            a refusal (`quota`): what to do about it.
        inspect: finds why new or changed workloads cannot run; called before the first write. It
            is the only part that is not data: only the builder of a release can decide what to
            check.
        defined: kinds, as (group, kind), that another part of the same deploy defines before.
        beside: objects that its builder makes before it is written; no revision has them.
        source: the folder of the Rigelfile, "" if it is not known.
    """

    release: ReleaseId
    objects: tuple[Manifest, ...]
    origins: Mapping[ObjectRef, Path] = attrs.field(factory=dict)
    options: Mapping[str, Any] = attrs.field(factory=dict)
    create_namespace: bool = False
    protected: frozenset[ObjectRef] = frozenset()
    remedies: Mapping[str, str] = attrs.field(factory=dict)
    inspect: Inspect | None = attrs.field(default=None, eq=False, repr=False)
    defined: frozenset[tuple[str, str]] = frozenset()
    beside: frozenset[ObjectRef] = frozenset()
    source: str = ""


@attrs.frozen
class Step:
    """One thing that apply will do.

    Attributes:
        live: the object on the cluster now, None if it does not exist.
        result: what it will be (the dry run's answer), None for a prune.
        replaces: the live object is deleted first, since it cannot be changed to that.
    """

    action: Literal["create", "change", "keep", "prune", "forget"]
    ref: ObjectRef
    manifest: Manifest | None = None
    live: Manifest | None = None
    result: Manifest | None = None
    replaces: bool = False

    @property
    def writes(self) -> bool:
        """Whether it changes the cluster."""
        return self.action not in ("keep", "forget")


@attrs.frozen
class Plan:
    """All steps of a deploy, in the order of apply.

    Attributes:
        records: what the release kept about itself, and a `down` has removed: revisions, a Lease.
    """

    release: ReleaseId
    steps: tuple[Step, ...]
    records: tuple[ObjectRef, ...] = ()

    @property
    def changes(self) -> tuple[Step, ...]:
        return tuple(step for step in self.steps if step.writes)

    @property
    def is_empty(self) -> bool:
        """Whether a `down` found nothing of the release."""
        return not self.steps and not self.records


@attrs.frozen
class InventoryItem:
    """An object that a revision owns, and the UID it had ("" before it was created)."""

    ref: ObjectRef
    uid: str = ""


RevisionStatus: TypeAlias = Literal["pending", "interrupted", "good", "failed", "superseded"]


@attrs.frozen
class Revision:
    """One record of a release; kept as a compressed Secret.

    Attributes:
        back_to: the revision that this rollback deploys again; None for a deploy.
        by: user@machine of the process that made it.
        failure: why it failed, in one line.
        source: the folder of the Rigelfile, "" if it is not known.
    """

    release: ReleaseId
    number: int
    status: RevisionStatus
    created: str
    objects: tuple[Manifest, ...]
    inventory: tuple[InventoryItem, ...]
    options: Mapping[str, Any] = attrs.field(factory=dict)
    description: str = ""
    tool_version: str = ""
    back_to: int | None = None
    by: str = ""
    failure: str = ""
    source: str = ""


@attrs.frozen(kw_only=True)
class DeployOptions:
    """How a release is deployed, rolled back or deleted, independent of its content.

    Attributes:
        cancel: set to interrupt it.
        timeout: seconds that the roll-out, or the end of the pods, may take; None: the default.
        adopt: take over objects and fields of other owners.
        description: the revision's name in the history.
        lock_timeout: seconds to wait for another deploy of the release; None: as `timeout`.
        names_release: a command must name the release, because the Rigelfile alone does not.
    """

    report: Reporter
    cancel: threading.Event = attrs.field(factory=threading.Event)
    timeout: float | None = None
    adopt: bool = False
    description: str = ""
    lock_timeout: float | None = None
    names_release: bool = False

    @classmethod
    def of(
        cls, settings: Settings, report: Reporter, cancel: threading.Event, description: str = ""
    ) -> DeployOptions:
        """Return what the command line has set."""
        return cls(
            report=report,
            cancel=cancel,
            timeout=settings.timeout,
            adopt=settings.adopt,
            description=description,
            lock_timeout=settings.lock_timeout,
        )

    def write_command(self, command: str, release: ReleaseId) -> str:
        """Return a command about a release for a hint, as it is typed in the same directory."""
        if not self.names_release:
            return f"`rigel {command}`"
        name = release.name if command == "status" else f"--release {release.name}"
        return f"`rigel {command} {name} -n {release.namespace}`"

    @property
    def limit(self) -> float:
        """Seconds that a roll-out may take."""
        return DEFAULT_TIMEOUT if self.timeout is None else self.timeout

    @property
    def lock_limit(self) -> float:
        """Seconds to wait for another deploy of the release."""
        return self.limit if self.lock_timeout is None else self.lock_timeout


FIRST = ("Namespace", "CustomResourceDefinition", "PriorityClass", "StorageClass")
ORDER = (
    *FIRST,
    "ServiceAccount",
    "Role",
    "ClusterRole",
    "RoleBinding",
    "ClusterRoleBinding",
    "ResourceQuota",
    "LimitRange",
    "ConfigMap",
    "Secret",
    "PersistentVolume",
    "PersistentVolumeClaim",
    "NetworkAttachmentDefinition",
    "NetworkPolicy",
    "Service",
)
BINDINGS = ("RoleBinding", "ClusterRoleBinding")
#: Kinds that run pods, and the pod itself.
WORKLOADS = ("DaemonSet", "StatefulSet", "Deployment", "Job", "CronJob", "Pod")
#: The kinds of workloads that a release's own objects have, with their API versions.
RUNNING = (
    ("apps/v1", "Deployment"),
    ("apps/v1", "DaemonSet"),
    ("apps/v1", "StatefulSet"),
    ("batch/v1", "Job"),
)
#: Kinds that hold data: they are deleted only on request. With a definition every object of its
#: kind is deleted, of all applications.
PROTECTED = frozenset({"PersistentVolumeClaim", "PersistentVolume", "CustomResourceDefinition"})


def rank(kind: str) -> int:
    """Return the place of a kind in the order of apply; unknown kinds come before pods."""
    if kind in ORDER:
        return ORDER.index(kind)
    return len(ORDER) + (1 + WORKLOADS.index(kind) if kind in WORKLOADS else 0)


def wave(kind: str) -> int:
    """Return which objects are applied together: 0 what defines kinds, 1 the rest, then workloads.

    Bindings are between them: a user without the right to bind any Role may bind an existing one.
    """
    if kind in FIRST:
        return 0
    if kind in WORKLOADS:
        return 3
    return 2 if kind in BINDINGS else 1

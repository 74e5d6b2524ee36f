"""The releases that a namespace or a whole cluster has, each in one line; it writes nothing.

One LIST of the revisions, without their data, and one for each kind of workload, however many
releases there are.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any

import attrs

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.labelling import is_applied
from rigel_k8s.release.revisions import CREATED, DESCRIPTION, OF, STATUS, VERSION, number_of
from rigel_k8s.release.rollout.readiness import readiness
from rigel_k8s.release.types import RUNNING, ReleaseId

Live = Mapping[str, Any]
DAMAGED = "damaged"


@attrs.frozen
class ReleaseSummary:
    """A release in one line.

    Attributes:
        status: of the newest revision: good, pending, interrupted or failed; damaged if it has
            none.
        ready: how many of its workloads are ready.
        workloads: how many it has.
        updated: when the newest revision was made, as Kubernetes writes times.
        description: what made that revision: the job, or a rollback.
        tool_version: the version of this tool that made it.
    """

    release: ReleaseId
    revision: int
    status: str
    ready: int
    workloads: int
    updated: str
    description: str
    tool_version: str


def list_releases(cluster: Cluster, namespace: str | None) -> list[ReleaseSummary]:
    """Return the releases of a namespace, or of all namespaces if it is None, by name."""
    queries = [
        partial(cluster.list, "v1", "Secret", namespace, labels=OF, metadata_only=True),
        *(partial(cluster.list, *kind, namespace, labels=RELEASE_LABEL) for kind in RUNNING),
    ]
    secrets, *workloads = cluster.gather(*queries)
    return summarise(secrets, chain.from_iterable(workloads))


def summarise(secrets: Iterable[Live], workloads: Iterable[Live]) -> list[ReleaseSummary]:
    """Return a line for each release that has a revision.

    Args:
        secrets: the Secrets of revisions; their data is not looked at.
        workloads: those with a release's label, whatever made them.
    """
    newest: dict[ReleaseId, Live] = {}
    for secret in secrets:
        release = ReleaseId(secret["metadata"]["namespace"], secret["metadata"]["labels"][OF])
        if number_of(secret) > (number_of(newest[release]) if release in newest else 0):
            newest[release] = secret
    own: dict[ReleaseId, list[bool]] = {}
    for live in filter(is_applied, workloads):
        meta = live["metadata"]
        state = readiness(live)
        there = own.setdefault(ReleaseId(meta["namespace"], meta["labels"][RELEASE_LABEL]), [])
        there.append(state.done and state.ok)
    return [
        describe(release, newest[release], own.get(release, ()))
        for release in sorted(newest, key=lambda one: (one.namespace, one.name))
    ]


def describe(release: ReleaseId, secret: Live, ready: Sequence[bool]) -> ReleaseSummary:
    """Return a release's line.

    Args:
        secret: its newest revision.
        ready: for each of its workloads whether it is ready.
    """
    notes = secret["metadata"].get("annotations") or {}
    return ReleaseSummary(
        release,
        number_of(secret),
        secret["metadata"]["labels"].get(STATUS, DAMAGED),
        sum(ready),
        len(ready),
        notes.get(CREATED, ""),
        notes.get(DESCRIPTION, ""),
        notes.get(VERSION, ""),
    )

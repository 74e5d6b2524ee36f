"""One object of a release, written only onto what the plan saw: no change of others is lost.

All releases write as one field manager, so Kubernetes sees no conflict between two of them. The API
server checks, together with the write, that nothing is written onto another release's object: an
object is created only if none exists, and changed only while it has the UID that the plan saw.
"""

from __future__ import annotations

from contextlib import suppress

from rigel_k8s.errors import ConflictError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.conditions import ANYTHING, NOTHING, Onto, this_object, this_state
from rigel_k8s.kube.failures import Conflict
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.ownership import managers, take_over
from rigel_k8s.release.part import Run
from rigel_k8s.release.survey import Live, belongs, describe_namespace, describe_owner
from rigel_k8s.release.types import ReleaseId

TRIES = 10


def write(run: Run, manifest: Manifest, live: Manifest | None) -> Live:
    """Apply a manifest and return the resulting object.

    Args:
        live: what the plan saw, None for nothing.

    Raises:
        ConflictError: another object exists by now, or other managers own fields.
    """
    cluster, adopt, ref = run.cluster, run.options.adopt, ref_of(manifest)
    for again in range(TRIES):
        try:
            if live is not None and adopt and managers(live):
                live = own_all(cluster, ref, live)
            condition = choose_condition(ref, live, run.release)
            return cluster.apply(manifest, force=adopt, onto=condition)
        except Conflict as error:
            if error.fields or again == TRIES - 1:
                raise
            live = look_again(cluster, ref, live, run.release)
    raise AssertionError("the last try returns or raises")


def make_namespace(cluster: Cluster, name: str) -> None:
    """Create a namespace if it does not exist."""
    manifest = describe_namespace(name)
    if cluster.get(ref_of(manifest)) is None:
        with suppress(ConflictError):  # another deploy was faster
            cluster.create(manifest)


def choose_condition(ref: ObjectRef, live: Manifest | None, release: ReleaseId) -> Onto:
    """Return the condition under which a manifest is applied.

    Controllers write the status of an object at any time, so an object of ours may have changed.
    One that belongs to no release must not: another release may be about to adopt it, too.
    """
    if ref.kind == "Namespace":  # releases share it
        return ANYTHING
    if live is None:
        return NOTHING
    return this_object(live) if belongs(live, release) else this_state(live)


def own_all(cluster: Cluster, ref: ObjectRef, live: Manifest) -> Live:
    """Make ours what other tools have set, so that what we leave out is removed."""
    meta = {
        "managedFields": take_over(live),
        "resourceVersion": live["metadata"]["resourceVersion"],
    }
    return cluster.patch(ref, {"metadata": meta})


def look_again(
    cluster: Cluster, ref: ObjectRef, live: Manifest | None, release: ReleaseId
) -> Live | None:
    """Return what exists by now, if it is still ours to write.

    It is in two cases: our own first request arrived and only its answer was lost, or an object
    that is being adopted has a new status.

    Raises:
        ConflictError: it is not.
    """
    now = cluster.get(ref)
    if now is None:
        if live is None:
            return None
        raise ConflictError(
            f"{ref} was deleted by another program during this deploy", hint="run it again"
        )
    if belongs(now, release):
        return now
    if owner := describe_owner(now):
        raise ConflictError(
            f"{ref} belongs to another release ({owner}), which made it during this deploy",
            hint="choose another name for it, and run it again",
        )
    if live is not None and live["metadata"]["uid"] == now["metadata"]["uid"]:
        return now
    maker = ", ".join(managers(now)) or "another program"
    raise ConflictError(
        f"{ref} was made by {maker} during this deploy",
        hint="choose another name for it, or take it over with --adopt, and run it again",
    )

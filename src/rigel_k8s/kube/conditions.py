"""What must exist for an apply: conditions that the API server checks with the write itself.

Server-side apply has no option for this. But it compares the `uid` and the `resourceVersion` of
what is sent. A version that no object ever has (etcd counts from 2) matches only if no object
exists: then the object is created, and the version is ignored.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from rigel_k8s.kube.failures import Conflict, Refusal
from rigel_k8s.objects.refs import Manifest


@attrs.frozen
class Onto:
    """What must exist: metadata that the API server compares."""

    metadata: Mapping[str, str] = attrs.field(factory=dict)


ANYTHING = Onto()
NOTHING = Onto({"resourceVersion": "1"})


def this_object(live: Manifest) -> Onto:
    """Return the condition that the object with this UID still exists, in any state."""
    return Onto({"uid": live["metadata"]["uid"]})


def this_state(live: Manifest) -> Onto:
    """Return the condition that an object has not changed at all, not even its status."""
    meta = live["metadata"]
    return Onto({"uid": meta["uid"], "resourceVersion": meta["resourceVersion"]})


def another_object_error(error: Refusal) -> Conflict:
    """Return the error for a 422 about the UID: another object has the name now."""
    conflict = Conflict(error.message, hint=error.hint, details=error.details)
    conflict.status, conflict.reason = 409, "Conflict"
    return conflict

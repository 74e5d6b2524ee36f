"""What each kind of cause means for which something does not become ready.

docs/errors.md is generated from it; patience.py has how long a deploy waits for each.
"""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.kinds import Kind

CAUSES: Mapping[str, Kind] = {
    "image": Kind(
        "the image cannot be pulled",
        "push it, correct its name, or give the namespace a pull secret",
    ),
    "image-name": Kind("the image's name is malformed", "correct `image`"),
    "start": Kind(
        "the container cannot be created, for example because a Secret or a program is missing",
        "create what the message names",
    ),
    "crash": Kind("the container ends again and again", "read its log: `rigel logs -p NODE`"),
    "restarted": Kind("the container has ended once and runs again", "read its log"),
    "unschedulable": Kind(
        "no machine accepts the pod", "change `placement`, `resources` or the machines' taints"
    ),
    "claim": Kind("a claim is not bound", "check its StorageClass and size"),
    "quota": Kind("a quota prevents further pods", "request less, or have it raised"),
    "mount": Kind("a volume cannot be mounted", "read the event in the message"),
    "sandbox": Kind(
        "the pod's network cannot be set up", "check Multus and the CNI on that machine"
    ),
    "evicted": Kind("the machine has evicted the pod", "free memory or disk space there"),
    "failed": Kind("the pod or the Job has failed for good", "read its log"),
    "away": Kind(
        "Kubernetes cannot reach the machine", "switch it on; pinned pods continue when it is back"
    ),
}

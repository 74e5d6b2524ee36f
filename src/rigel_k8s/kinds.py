"""What the states of pods and the words of kubectl mean, with causes and remedies.

The kinds of problems, the words in brackets behind messages, need no table: the message says what
is wrong and what to do. Those that have more to be said are explained beside their feature: why
something is not ready in release/rollout/causes.py, what a guest finds beside its checks.
`rigel explain` and docs/errors.md print them all.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs


@attrs.frozen
class Kind:
    """What one word means.

    Attributes:
        cause: what is wrong: a clause in lower case, in Markdown.
        remedy: what the user can do about it, in the imperative; "" where nothing is to be done.
    """

    cause: str
    remedy: str


#: What `kind` of a pod in `rigel status -o json` may be, beside the causes of a deploy.
PODS: Mapping[str, Kind] = {
    "orphan": Kind(
        "a restarted ROS master has forgotten the pod's node",
        "restart the pod; with `gate: true` roscore"
        " [gets its registrations back](ros1.md#when-roscore-ends)",
    ),
    "waits": Kind(
        "the new pod runs, and waits to take over from the old one, whose goals must end first",
        "wait, or set a shorter `drain` in `update`; see [updates](ros2-updates.md)",
    ),
}

#: What `kubectl get pods` shows of a pod that does not run.
KUBECTL: Mapping[str, Kind] = {
    "Pending": Kind(
        "no machine fits the pod, or its image or volumes are not there yet",
        "`rigel status` reports which",
    ),
    "ErrImagePull": Kind(
        "the image cannot be pulled", "check its name, the registry and `image_pull_secrets`"
    ),
    "ImagePullBackOff": Kind(
        "the image cannot be pulled, and Kubernetes waits before it tries again",
        "check its name, the registry and `image_pull_secrets`",
    ),
    "CreateContainerConfigError": Kind(
        "a Secret or a ConfigMap that the container needs does not exist",
        "create it; `rigel status` reports its name",
    ),
    "CrashLoopBackOff": Kind(
        "the program has ended several times, and Kubernetes waits before it starts it again",
        "read its last lines with `rigel logs NODE`, and correct what it runs",
    ),
    "OOMKilled": Kind(
        "the container used more memory than its limit, or than its machine has",
        "raise `resources.limits.memory` of the node",
    ),
    "Evicted": Kind(
        "the machine ran out of memory or disk space", "free memory or disk space there"
    ),
}

"""The roll-out of Multus and whereabouts to the machines that are up.

An unreachable machine does not stop a roll-out, which is complete without it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.errors import Interrupted, RolloutFailed
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.desired import Installation
from rigel_k8s.network.multus.installation import Found
from rigel_k8s.objects.facts import stays_ready
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release.types import DeployOptions

Object = Mapping[str, Any]

LOOK = 1.0
STOPPED = "interrupted while the network was being installed"


@attrs.frozen
class Rollout:
    """One roll-out.

    Attributes:
        found: the cluster before it.
    """

    cluster: Cluster
    installation: Installation
    found: Found
    options: DeployOptions

    def let_be_away(self) -> None:
        """Let it continue although machines are unreachable: Kubernetes would wait for them."""
        rolling = {"rollingUpdate": {"maxUnavailable": 1 + len(self.found.away)}}
        for part in (self.found.multus, self.found.whereabouts):
            for one in part.sets if self.found.away and part and part.ours else ():
                self.cluster.patch(ref_of(one), {"spec": {"updateStrategy": rolling}})

    def wait(self) -> None:
        """Return when both parts are ready on all machines that are up.

        Raises:
            RolloutFailed: they are not within the time.
            Interrupted: `options.cancel` was set.
        """
        end = time.monotonic() + self.options.limit
        while lines := list(self.find_unready()):
            if time.monotonic() > end:
                raise RolloutFailed(
                    f"the network is not ready on every machine within {self.options.limit:g} s",
                    hint=f"kubectl -n {RELEASE.namespace} describe pods"
                    f" -l {RELEASE_LABEL}={RELEASE.name}",
                    details=lines,
                )
            self.options.report.progress("network", lines[0])
            if self.options.cancel.wait(LOOK):
                raise Interrupted(STOPPED)

    def find_unready(self) -> Iterator[str]:
        """Yield what is not ready or not up to date on the machines that are up."""
        labels = {RELEASE_LABEL: RELEASE.name}
        for one in self.cluster.list("apps/v1", "DaemonSet", RELEASE.namespace, labels=labels):
            status = one.get("status", {})
            wanted = status.get("desiredNumberScheduled", 0) - len(self.found.away)
            if status.get("updatedNumberScheduled", 0) < wanted:
                yield f"not all pods of {one['metadata']['name']} are up to date"
        pods = self.cluster.list("v1", "Pod", RELEASE.namespace, labels=labels)
        ready = {(pod["spec"].get("nodeName"), part_of(pod)) for pod in pods if stays_ready(pod)}
        ours = {"multus": self.installation.multus, "whereabouts": self.installation.whereabouts}
        for node in self.found.up:
            for part in (name for name, mine in ours.items() if mine):
                if (node, part) not in ready:
                    yield f"{part} is not ready on {node}"


def part_of(pod: Object) -> str:
    """Return which part one of our pods runs, "" for neither."""
    name = str((pod["metadata"].get("labels") or {}).get("app.kubernetes.io/name", ""))
    if name.endswith("reconciler"):
        return ""
    return "multus" if name.startswith("rigel-multus") else "whereabouts"

"""The release of Multus and whereabouts, rolled out to the machines that are up.

An unreachable machine does not stop a roll-out, which is complete without it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from importlib.resources import files
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, Interrupted, RolloutFailed
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.desired import Installation, network_release
from rigel_k8s.network.multus.installation import Found
from rigel_k8s.objects.facts import stays_ready
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.pinning import pin
from rigel_k8s.release import revisions
from rigel_k8s.release.deploy import deploy, diff, find_last_good
from rigel_k8s.release.lease import lease_ref
from rigel_k8s.release.locking import bury_left
from rigel_k8s.release.types import DeployOptions, Desired

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

    def run(self) -> None:
        """Apply what differs, and return when both parts are ready on all machines that are up.

        Raises:
            RolloutFailed: they are not, and the cause is not an unreachable machine.
            ClusterError, ConflictError, Refused: as in deploy.
        """
        desired = find_release(self.cluster, self.installation, self.found)
        end = time.monotonic() + self.options.limit
        while self._is_due(desired):
            self._let_be_away()
            try:
                options = attrs.evolve(self.options, description="network")
                deploy(desired, self.cluster, options, away=self.found.away)
            except ClusterError:
                if not self._wait_for_others(end):
                    raise
            else:
                break
        bury_left(self.cluster, RELEASE, self.options.report)
        self._wait_until_complete(lambda: list(self._find_unready()), end)

    def _is_due(self, desired: Desired) -> bool:
        """Return whether something differs, or an installation was interrupted before its end."""
        if diff(desired, self.cluster, adopt=self.options.adopt).changes:
            return True
        records = revisions.records(self.cluster, RELEASE)
        return bool(records) and records[-1].status != "good"

    def _let_be_away(self) -> None:
        """Let it continue although machines are unreachable: Kubernetes would wait for them."""
        rolling = {"rollingUpdate": {"maxUnavailable": 1 + len(self.found.away)}}
        for part in (self.found.multus, self.found.whereabouts):
            for one in part.sets if self.found.away and part and part.ours else ():
                self.cluster.patch(ref_of(one), {"spec": {"updateStrategy": rolling}})

    def _wait_for_others(self, end: float) -> bool:
        """Wait while another `rigel` installs the same; return whether one did."""
        ref = lease_ref(RELEASE)
        lease = self.cluster.get(ref)
        if lease is None:
            return False
        self.options.report.line(
            f"{lease['spec'].get('holderIdentity')} installs the network: waiting"
        )
        while self.cluster.get(ref) is not None and time.monotonic() < end:
            if self.options.cancel.wait(LOOK):
                raise Interrupted(STOPPED)
        return time.monotonic() < end

    def _wait_until_complete(self, find_missing: Callable[[], list[str]], end: float) -> None:
        """Wait until nothing is missing."""
        while lines := find_missing():
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

    def _find_unready(self) -> Iterator[str]:
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


def find_release(cluster: Cluster, installation: Installation, found: Found) -> Desired:
    """Return the desired state of the release, with images by digest."""
    desired = network_release(installation, machine_script())
    return pin(desired, find_last_good(cluster, RELEASE), lambda: found.nodes)


def machine_script() -> str:
    """Return the text of machine.sh."""
    return (files("rigel_k8s.network.multus") / "machine.sh").read_text(encoding="utf-8")


def part_of(pod: Object) -> str:
    """Return which part one of our pods runs, "" for neither."""
    name = str((pod["metadata"].get("labels") or {}).get("app.kubernetes.io/name", ""))
    if name.endswith("reconciler"):
        return ""
    return "multus" if name.startswith("rigel-multus") else "whereabouts"

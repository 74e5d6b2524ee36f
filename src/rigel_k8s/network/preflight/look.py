"""Examines the cluster, and its machines through Multus' daemons; only reads.

What must not be read or does not answer becomes one warning, not a failure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.network.preflight.attachments import (
    API,
    KIND,
    POOL_API,
    POOL_KIND,
    Attachment,
    attachment,
    subnet,
)
from rigel_k8s.network.preflight.case import Case, MachineView
from rigel_k8s.network.preflight.daemon import Daemon, daemon, is_multus
from rigel_k8s.network.preflight.finding import UNSEEN, group_by_text
from rigel_k8s.network.preflight.machine import PROBE, MachineFacts, Subnet, parse
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.problems import Problem
from rigel_k8s.release.rollout.causes import owner

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

T = TypeVar("T")
Manifest = Mapping[str, Any]

NOTHING: Sequence[Manifest] = ()
PATIENCE = 10.0  # seconds for the script on one machine, which takes a tenth of one


def look(case: Case, cluster: Cluster) -> tuple[Case, list[Problem]]:
    """Return the case with the facts about the cluster, and a warning of what is unknown."""
    eyes = _Eyes(cluster)
    case = attrs.evolve(case, view=eyes.cluster_view(case))
    view = attrs.evolve(case.view, machines=eyes.machines(case))
    # With mode `host` the machines' facts are not needed, so no warning that they are unknown.
    return attrs.evolve(case, view=view), eyes.report_unseen() if case.keys else []


class _Eyes:
    """Examines a cluster, and records what could not be examined."""

    def __init__(self, cluster: Cluster):
        self._cluster = cluster
        self._unseen: dict[str, str] = {}  # what -> why not

    def report_unseen(self) -> list[Problem]:
        """Return the warning that lists what could not be examined."""
        if not self._unseen:
            return []
        parts = "; ".join(
            f"{', '.join(sorted(what))} ({why})"
            for why, what in group_by_text(self._unseen).items()
        )
        return [
            UNSEEN.problem(
                f"preflight could not check {parts}",
                "problems there appear when pods start",
            )
        ]

    def cluster_view(self, case: Case) -> MachineView:
        """Return all facts except the machines'; the requests run in parallel."""
        cluster, attaching = self._cluster, bool(case.keys)
        questions: dict[str, Callable[[], Any]] = {
            "nodes": lambda: self._ask("nodes", cluster.nodes, NOTHING),
            "daemons": self._daemons,
            "policies": lambda: self._ask("NetworkPolicies", lambda: self._policies(case), NOTHING),
        }
        if attaching:
            questions |= {
                "multus": lambda: self._serves(API, KIND),
                "whereabouts": lambda: self._serves(POOL_API, POOL_KIND),
                "attachments": lambda: self._attachments(case),
                "services": self._service_ranges,
            }
        answers = cluster.parallel(lambda ask: ask(), questions.values())
        known = dict(zip(questions, answers, strict=True))
        attachments, unread = known.pop("attachments", ({}, frozenset()))
        return MachineView(**known, attachments=attachments, unread=unread)

    def machines(self, case: Case) -> dict[str, MachineFacts]:
        """Return the facts of the machines that pods may run on, examined in parallel."""
        daemons = case.view.daemons or {}
        nodes = [node for node in case.nodes() if node in daemons]
        for node in (node for node in nodes if node not in case.ready):
            self._unseen[node] = "not ready"
        asked = [daemons[n] for n in nodes if n in case.ready and not daemons[n].state]
        answers = self._cluster.parallel(self._machine, asked)
        return {one.node: facts for one, facts in zip(asked, answers, strict=True) if facts}

    def _ask(self, what: str, question: Callable[[], T], otherwise: T) -> T:
        try:
            return question()
        except ClusterError as error:
            self._unseen[what] = _explain(error)
            return otherwise

    def _serves(self, api: str, kind: str) -> bool:
        return self._ask(f"kinds of {api}", lambda: self._cluster.serves(api, kind), True)

    def _daemons(self) -> Mapping[str, Daemon] | None:
        """Return Multus' pods by machine, independent of their installer and their name."""
        return self._ask("Multus' daemons", self._find_daemons, None)

    def _find_daemons(self) -> Mapping[str, Daemon] | None:
        sets = self._cluster.list("apps/v1", "DaemonSet")
        pods = [pod for one in sets if is_multus(one) for pod in self._pods_of(one)]
        return {pod["spec"].get("nodeName", ""): daemon(pod) for pod in pods}

    def _pods_of(self, daemon_set: Manifest) -> Iterable[Manifest]:
        labels = daemon_set["spec"]["selector"].get("matchLabels") or {}
        meta = daemon_set["metadata"]
        for pod in self._cluster.list("v1", "Pod", meta["namespace"], labels=labels):
            if owner(pod) == meta["uid"] and not pod["metadata"].get("deletionTimestamp"):
                yield pod

    def _policies(self, case: Case) -> Sequence[Manifest]:
        namespace = case.wanted[0].namespace
        return self._cluster.list("networking.k8s.io/v1", "NetworkPolicy", namespace)

    def _service_ranges(self) -> Sequence[Subnet]:
        """Return the ranges of Services; before Kubernetes 1.33, which lists them, one address."""
        try:
            listed = self._cluster.list("networking.k8s.io/v1", "ServiceCIDR")
        except ClusterError:
            listed = []
        texts = [text for one in listed for text in (one.get("spec") or {}).get("cidrs") or []]
        if not texts:
            kubernetes = ObjectRef("v1", "Service", "default", "kubernetes")
            service = self._ask("Services", lambda: self._cluster.get(kubernetes), None)
            texts = ((service or {}).get("spec") or {}).get("clusterIPs") or []
        return [one for one in map(subnet, texts) if one is not None]

    def _attachments(self, case: Case) -> tuple[dict[str, Attachment], frozenset[str]]:
        """Return the cluster's attachments, at least those that pods request."""
        try:
            items = self._cluster.list(API, KIND)
        except ClusterError as error:
            self._unseen["NetworkAttachmentDefinitions of other namespaces"] = _explain(error)
            return self._find_named([key for key in case.keys if key not in case.own])
        return {one.key: one for one in map(attachment, items)}, frozenset()

    def _find_named(self, keys: Sequence[str]) -> tuple[dict[str, Attachment], frozenset[str]]:
        found: dict[str, Attachment] = {}
        unread = []
        for key in keys:
            namespace, _, name = key.partition("/")
            try:
                item = self._cluster.get(ObjectRef(API, KIND, namespace, name))
            except ClusterError:
                unread.append(key)
            else:
                found |= {key: attachment(item)} if item else {}
        return found, frozenset(unread)

    def _machine(self, one: Daemon) -> MachineFacts | None:
        """Run the script on a machine."""
        command = ["/bin/sh", "-c", PROBE, "preflight", one.root.rstrip("/"), *one.directories]
        try:
            done = self._cluster.run(
                one.namespace, one.pod, command, container=one.container, timeout=PATIENCE
            )
            return parse(done.stdout.decode("utf-8", "replace"))
        except (ClusterError, ValueError) as error:
            self._unseen[f"interfaces and CNI programs of {one.node}"] = _explain(error)
            return None


def _explain(error: Exception) -> str:
    """Return why something could not be examined; `forbidden` needs no details."""
    return "forbidden" if isinstance(error, Forbidden) else str(error)

"""Examines the cluster, and its machines through Multus' daemons; only reads.

What must not be read or does not answer becomes one warning, not a failure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.problems import Problem
from rigel_k8s.release.rollout.view import owner
from rigel_multus.installation import runs
from rigel_multus.preflight.attachments import (
    API,
    KIND,
    POOL_API,
    POOL_KIND,
    AttachmentFacts,
    read_attachment,
    read_subnet,
)
from rigel_multus.preflight.case import Case, ClusterView
from rigel_multus.preflight.checks import UNSEEN, group_by_text
from rigel_multus.preflight.machine import (
    PROBE,
    Daemon,
    MachineFacts,
    Subnet,
    parse,
    read_daemon,
)

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

T = TypeVar("T")
Manifest = Mapping[str, Any]
#: Attachments by NAMESPACE/NAME, and those that could not be read.
Attachments = tuple[dict[str, AttachmentFacts], frozenset[str]]

PATIENCE = 10.0  # seconds for the script on one machine, which takes a tenth of one


def look(case: Case, cluster: Cluster) -> tuple[Case, list[Problem]]:
    """Return the case with the facts about the cluster, and a warning of what is unknown."""
    examination = Examination(cluster)
    case = attrs.evolve(case, view=examination.see_cluster(case))
    view = attrs.evolve(case.view, machines=examination.see_machines(case))
    # With mode `host` the machines' facts are not needed, so no warning that they are unknown.
    return attrs.evolve(case, view=view), examination.report_unseen() if case.keys else []


@attrs.frozen
class Examination:
    """One examination of a cluster.

    Attributes:
        unseen: what could not be examined -> why not.
    """

    cluster: Cluster
    unseen: dict[str, str] = attrs.field(factory=dict)

    def report_unseen(self) -> list[Problem]:
        """Return the warning that lists what could not be examined."""
        if not self.unseen:
            return []
        parts = "; ".join(
            f"{', '.join(sorted(what))} ({why})" for why, what in group_by_text(self.unseen).items()
        )
        message = f"preflight could not check {parts}"
        return [UNSEEN.problem(message, "problems there appear when pods start")]

    def see_cluster(self, case: Case) -> ClusterView:
        """Return all facts except the machines'; the requests run in parallel."""
        nothing: Sequence[Manifest] = ()
        questions: dict[str, Callable[[], Any]] = {
            "nodes": lambda: self.ask("nodes", self.cluster.nodes, nothing),
            "daemons": lambda: self.ask("Multus' daemons", self.find_daemons, None),
        }
        if case.keys:
            questions |= {
                "multus": lambda: self.serves(API, KIND),
                "whereabouts": lambda: self.serves(POOL_API, POOL_KIND),
                "attachments": lambda: self.find_attachments(case),
                "services": self.find_service_ranges,
            }
        answers = self.cluster.gather(*questions.values())
        known = dict(zip(questions, answers, strict=True))
        attachments, unread = known.pop("attachments", ({}, frozenset()))
        return ClusterView(**known, attachments=attachments, unread=unread)

    def see_machines(self, case: Case) -> dict[str, MachineFacts]:
        """Return the facts of the machines that pods may run on, examined in parallel."""
        daemons = case.view.daemons or {}
        nodes = [node for node in case.nodes() if node in daemons]
        self.unseen.update({node: "not ready" for node in nodes if node not in case.ready})
        asked = [daemons[n] for n in nodes if n in case.ready and not daemons[n].state]
        answers = self.cluster.parallel(self.see_machine, asked)
        return {one.node: facts for one, facts in zip(asked, answers, strict=True) if facts}

    def see_machine(self, one: Daemon) -> MachineFacts | None:
        """Run the script on a machine."""
        command = ["/bin/sh", "-c", PROBE, "preflight", one.root.rstrip("/"), *one.directories]
        try:
            done = self.cluster.run(
                one.namespace, one.pod, command, container=one.container, timeout=PATIENCE
            )
            return parse(done.stdout.decode("utf-8", "replace"))
        except (ClusterError, ValueError) as error:
            self.unseen[f"interfaces and CNI programs of {one.node}"] = explain(error)
            return None

    def ask(self, what: str, question: Callable[[], T], otherwise: T) -> T:
        """Return the answer to a question; without one, note that and return `otherwise`."""
        try:
            return question()
        except ClusterError as error:
            self.unseen[what] = explain(error)
            return otherwise

    def serves(self, api: str, kind: str) -> bool:
        return self.ask(f"kinds of {api}", lambda: self.cluster.serves(api, kind), True)

    def find_daemons(self) -> Mapping[str, Daemon] | None:
        """Return Multus' pods by machine, independent of their installer and their name."""
        daemons = {}
        for one in self.cluster.list("apps/v1", "DaemonSet"):
            if runs("multus", one):
                labels = one["spec"]["selector"].get("matchLabels") or {}
                meta = one["metadata"]
                for pod in self.cluster.list("v1", "Pod", meta["namespace"], labels=labels):
                    if owner(pod) == meta["uid"] and not pod["metadata"].get("deletionTimestamp"):
                        daemons[pod["spec"].get("nodeName", "")] = read_daemon(pod)
        return daemons

    def find_service_ranges(self) -> Sequence[Subnet]:
        """Return the ranges of Services; before Kubernetes 1.33, which lists them, one address."""
        try:
            listed = self.cluster.list("networking.k8s.io/v1", "ServiceCIDR")
        except ClusterError:
            listed = []
        texts = [text for one in listed for text in (one.get("spec") or {}).get("cidrs") or []]
        if not texts:
            kubernetes = ObjectRef("v1", "Service", "default", "kubernetes")
            service = self.ask("Services", lambda: self.cluster.get(kubernetes), None)
            texts = ((service or {}).get("spec") or {}).get("clusterIPs") or []
        return [one for one in map(read_subnet, texts) if one is not None]

    def find_attachments(self, case: Case) -> Attachments:
        """Return the cluster's attachments, at least those that pods request."""
        try:
            items = self.cluster.list(API, KIND)
        except ClusterError as error:
            self.unseen["NetworkAttachmentDefinitions of other namespaces"] = explain(error)
            return self.find_named([key for key in case.keys if key not in case.own])
        return {one.key: one for one in map(read_attachment, items)}, frozenset()

    def find_named(self, keys: Sequence[str]) -> Attachments:
        found: dict[str, AttachmentFacts] = {}
        unread = []
        for key in keys:
            namespace, _, name = key.partition("/")
            try:
                item = self.cluster.get(ObjectRef(API, KIND, namespace, name))
            except ClusterError:
                unread.append(key)
            else:
                found |= {key: read_attachment(item)} if item else {}
        return found, frozenset(unread)


def explain(error: Exception) -> str:
    """Return why something could not be examined; `forbidden` needs no details."""
    return "forbidden" if isinstance(error, Forbidden) else str(error)

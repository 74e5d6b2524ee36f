"""Asks the gate in front of a release's roscore for its state, which the master does not have.

The request is made inside its own container: the gate decides which pods may call it, and the
command line may be anywhere.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from rigel_gate.calls import DESCRIBE_GATE
from rigel_k8s.discovery.members import runs
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import explain_exec
from rigel_k8s.objects.facts import is_ending
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import NAME_LABEL
from rigel_k8s.objects.pods import GATE_CONTAINER, MASTER_NAME, MASTER_PORT
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rosgraph.handover import GateStatus, NameConflict, WaitingNode

#: Seconds that the gate has to answer, the start of a Python included.
LIMIT = 10.0
ASK = f"""
import sys, xmlrpc.client
gate = xmlrpc.client.ServerProxy("http://127.0.0.1:{MASTER_PORT}")
sys.stdout.write(gate.{DESCRIBE_GATE}("/rigel")[2])
"""


def read_gate(cluster: Cluster, release: ReleaseId) -> GateStatus | None:
    """Return the status of a release's gate; None if no gate runs."""
    labels = {RELEASE_LABEL: release.name, NAME_LABEL: MASTER_NAME}
    pods = cluster.list("v1", "Pod", release.namespace, labels=labels)
    names = [pod["metadata"]["name"] for pod in pods if runs_gate(pod) and not is_ending(pod)]
    if not names:
        return None
    command = ["python3", "-E", "-S", "-B", "-c", ASK]
    try:
        done = cluster.run(
            release.namespace, names[-1], command, container=GATE_CONTAINER, timeout=LIMIT
        )
    except ClusterError as error:
        return GateStatus(problem=explain_exec(error))
    if done.code != 0:
        errors = done.stderr.decode("utf-8", "replace").splitlines()
        return GateStatus(problem=errors[-1] if errors else f"exit code {done.code}")
    return parse(json.loads(done.stdout))


def runs_gate(pod: Mapping[str, Any]) -> bool:
    """Return whether a pod has a gate, and that runs."""
    has = any(one["name"] == GATE_CONTAINER for one in pod["spec"]["containers"])
    return has and runs(pod.get("status") or {}, GATE_CONTAINER)


def parse(answer: Mapping[str, Any]) -> GateStatus:
    """Return the gate's answer as a status."""
    return GateStatus(
        tuple(WaitingNode(one["node"], one["api"], one["owner"]) for one in answer["waiting"]),
        tuple(
            NameConflict(one["node"], one["old"], one["new"], one["time"])
            for one in answer["conflicts"]
        ),
        tuple(answer["silent"]),
        answer["has_master"],
        answer["restarts"],
        answer.get("blocked", ""),  # a gate of an older version does not have these
        tuple(answer.get("refused", ())),
        tuple(answer.get("unkept", ())),
    )

"""Proves that machines attach pods, and records which of them did.

The proof is one short pod on a machine, with a second network (files/proof.yaml).
"""

from __future__ import annotations

import hashlib
import json
import re
import threading
import time
import uuid
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from rigel_k8s.errors import ClusterError, Interrupted, RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.report import Reporter
from rigel_multus.installation import RELEASE, Installation
from rigel_multus.manifests import read

Object = Mapping[str, Any]

PROOF = "rigel-network-proof"
#: The label of all objects of one proof.
RUN_LABEL = "rigel-k8s/network-proof"
#: The pool that whereabouts makes for it.
POOL = f"{PROOF}-198.18.0.0-16"
#: Seconds that an attachment may take; meanwhile the kubelet tries again automatically.
TIMEOUT = 60.0
LOOK = 0.5
#: How often a pod's network may fail: the first time, a program may not be installed completely.
FAILURES = 3
RECORD = ObjectRef("v1", "ConfigMap", RELEASE.namespace, PROOF)


def prove(
    cluster: Cluster,
    nodes: Sequence[str],
    image: str,
    report: Reporter,
    cancel: threading.Event,
) -> dict[str, str]:
    """Start a pod with a second network on each machine; return the causes where that fails.

    Everything that it creates is deleted again.
    """
    run = uuid.uuid4().hex[:8]
    network = f"{PROOF}-{run}"
    proofs = []
    for node in nodes:
        pod = f"{network}-{hashlib.sha256(node.encode()).hexdigest()[:10]}"
        values = {"run": run, "network": network, "pod": pod, "node": node, "image": image}
        proofs.append(read("files", "proof", **values))
    attachment = proofs[0][0]
    try:
        cluster.create(attachment)
        cluster.parallel(cluster.create, [pod for _, pod in proofs])
        return watch(cluster, run, nodes, report, cancel)
    finally:
        clean_up(cluster, run, attachment)


def watch(
    cluster: Cluster, run: str, nodes: Sequence[str], report: Reporter, cancel: threading.Event
) -> dict[str, str]:
    """Wait until the pods have ended."""
    waiting, failed, end = set(nodes), dict[str, str](), time.monotonic() + TIMEOUT
    while waiting:
        for pod in list_pods(cluster, run):
            node = pod["spec"]["nodeName"]
            late = time.monotonic() > end
            cause = find_outcome(cluster, pod, late=late) if node in waiting else None
            if cause is None:
                continue
            waiting.discard(node)
            report.progress(node, cause or "attaches pods", done=True)
            if cause:
                failed[node] = cause
        if waiting and cancel.wait(LOOK):
            raise Interrupted("interrupted while the machines were trying an attachment")
    return failed


def find_outcome(cluster: Cluster, pod: Object, *, late: bool) -> str | None:
    """Return "" if a pod got its network, the cause if not, or None if that is not known yet."""
    phase = pod.get("status", {}).get("phase")
    if phase == "Succeeded":
        return ""
    if phase == "Failed":
        return "the pod came up without its second network"
    events = [e for e in cluster.events(pod) if e.get("reason") == "FailedCreatePodSandBox"]
    count = sum(int(event.get("count") or 1) for event in events)
    if events and (late or count >= FAILURES):
        return shorten(str(events[-1].get("message", "")))
    if late:
        return f"no attachment within {TIMEOUT:g} s: {describe_state(pod)}"
    return None


def shorten(message: str) -> str:
    """Return a plugin's own error without what the programs that pass it on add."""
    text = re.sub(r"[0-9a-f]{64}", "...", message)
    for start in (r"error adding container to network", r"ERRORED:", r"plugin type="):
        found = re.search(start, text)
        text = text[found.start() :] if found else text
    return text[:400]


def describe_state(pod: Object) -> str:
    """Return what a pod's container waits for."""
    for status in pod.get("status", {}).get("containerStatuses", []):
        waiting = status.get("state", {}).get("waiting", {})
        return f"{waiting.get('reason', '')} {waiting.get('message', '')}".strip()
    return "its machine has not started the pod"


def list_pods(cluster: Cluster, run: str) -> list[dict[str, Any]]:
    return cluster.list("v1", "Pod", RELEASE.namespace, labels={RUN_LABEL: run})


def clean_up(cluster: Cluster, run: str, attachment: Object) -> None:
    """Delete what a proof created; the pods first, since their end releases their addresses."""
    with suppress(ClusterError):
        cluster.parallel(cluster.delete, [ref_of(pod) for pod in list_pods(cluster, run)])
        end = time.monotonic() + TIMEOUT / 2
        while list_pods(cluster, run) and time.monotonic() < end:
            time.sleep(LOOK)
        cluster.delete(ref_of(attachment))
        if not cluster.list("v1", "Pod", RELEASE.namespace, labels=RUN_LABEL):
            api = "whereabouts.cni.cncf.io/v1alpha1"
            cluster.delete(ObjectRef(api, "IPPool", RELEASE.namespace, POOL))


def fingerprint(node: Object, sets: Iterable[Object]) -> str:
    """Return a hash of what a proof depends on: the machine, its boot, and what is installed."""
    info = node.get("status", {}).get("nodeInfo", {})
    parts = [node["metadata"].get("uid"), info.get("bootID"), info.get("kubeletVersion")]
    parts += [one["metadata"].get("uid") for one in sets]
    parts += [one["metadata"].get("generation") for one in sets]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def list_marks(installation: Installation) -> dict[str, str]:
    """Return the current fingerprint of each machine that is up."""
    sets = [one for presence in installation.parts.values() for one in presence.sets]
    return {node["metadata"]["name"]: fingerprint(node, sets) for node in installation.up}


def find_proven(cluster: Cluster, installation: Installation) -> set[str]:
    """Return the machines that are up and whose proof still holds."""
    live = cluster.get(RECORD) or {}
    known: Mapping[str, str] = live.get("data") or {}
    return {node for node, mark in list_marks(installation).items() if known.get(node) == mark}


def remember(cluster: Cluster, marks: Mapping[str, str]) -> None:
    """Record on the cluster which machines have attached a pod, for later installations."""
    labels = {RELEASE_LABEL: RELEASE.name}
    cluster.apply(
        {
            "apiVersion": "v1",
            "kind": "ConfigMap",
            "metadata": {"name": RECORD.name, "namespace": RECORD.namespace, "labels": labels},
            "data": dict(marks),
        }
    )


def forget(cluster: Cluster) -> None:
    with suppress(RigelK8sError):
        cluster.delete(RECORD)

"""The killed commands, on a release without running pods, each with the state before it.

This is independent of how a process dies; a test runs the same scenarios on a cluster in memory.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import attrs

from rigel_k8s.deploy import deploy, down, roll_back, write_release
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import SINGLETON_ANNOTATION
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.observability.options import StackRequest, request_of
from rigel_k8s.release.part import Part, Run
from rigel_k8s.release.types import DeployOptions, Desired, ReleaseId
from rigel_stack import install as stacks
from rigel_stack.install import desired_stack, render_stack

GONE_TIMEOUT = 180.0
#: Kinds that are compared.
KINDS = (
    ("v1", "ConfigMap"),
    ("v1", "Secret"),
    ("v1", "Service"),
    ("v1", "ServiceAccount"),
    ("v1", "PersistentVolumeClaim"),
    ("apps/v1", "Deployment"),
    ("apps/v1", "DaemonSet"),
    ("apps/v1", "StatefulSet"),
    ("coordination.k8s.io/v1", "Lease"),
)
#: The stack with few programs: the kills are about writes, not about pods.
STACK = {
    "loki": {"enabled": False},
    "prometheus": {"persistence": {"enabled": False}},
    "grafana": {"enabled": False},
}


class Silent:
    """A reporter that keeps nothing."""

    def line(self, text: str) -> None: ...

    def warn(self, text: str) -> None: ...

    def progress(self, key: str, state: str, *, done: bool = False) -> None: ...


OPTIONS = DeployOptions(report=Silent(), timeout=60)


@attrs.frozen
class Scenario:
    """One command and the state before it.

    Attributes:
        before: creates the state before the command in an empty namespace.
        command: the command to kill.
        undo: removes objects outside of the namespace.
    """

    name: str
    release: str
    before: Callable[[Cluster, str], object]
    command: Callable[[Cluster, str], object]
    undo: Callable[[Cluster, str], object] = lambda cluster, namespace: None


@attrs.frozen
class Snapshot:
    """The objects in a namespace.

    Attributes:
        objects: kind and name, with the data or spec that was applied, without revisions.
        revisions: their statuses, the oldest first.
    """

    objects: tuple[tuple[str, str, str], ...]
    revisions: tuple[str, ...]

    def is_as(self, wanted: Snapshot) -> bool:
        """Whether it equals the result of an undisturbed command; the history may be longer."""
        last = self.revisions[-1:] == wanted.revisions[-1:]
        return self.objects == wanted.objects and last and "pending" not in self.revisions


def take_snapshot(cluster: Cluster, scenario: Scenario, namespace: str) -> Snapshot:
    """Return the objects in a namespace."""
    objects: list[tuple[str, str, str]] = []
    statuses: dict[int, str] = {}
    for kind in KINDS:
        for live in cluster.list(*kind, namespace):
            labels = live["metadata"].get("labels") or {}
            if number := labels.get("rigel-k8s/revision"):
                statuses[int(number)] = labels["rigel-k8s/status"]
            elif not is_given(live):
                notes = live["metadata"].get("annotations") or {}
                objects.append((kind[1], live["metadata"]["name"], notes.get("rigel-k8s/hash", "")))
    return Snapshot(tuple(sorted(objects)), tuple(statuses[n] for n in sorted(statuses)))


def is_given(live: dict[str, Any]) -> bool:
    """Whether Kubernetes itself creates an object in each namespace."""
    return (live["kind"], live["metadata"]["name"]) in (
        ("ConfigMap", "kube-root-ca.crt"),
        ("ServiceAccount", "default"),
    )


def config(namespace: str, name: str, **data: str) -> dict[str, Any]:
    """Return a ConfigMap."""
    meta = {"name": name, "namespace": namespace}
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": meta, "data": data}


def claim(namespace: str) -> dict[str, Any]:
    """Return a claim that waits for its first pod."""
    return {
        "apiVersion": "v1",
        "kind": "PersistentVolumeClaim",
        "metadata": {"name": "data", "namespace": namespace},
        "spec": {"accessModes": ["ReadWriteOnce"], "resources": {"requests": {"storage": "1Mi"}}},
    }


def node(namespace: str, name: str, said: str) -> dict[str, Any]:
    """Return a node's Deployment: its ROS name stays when its object is renamed; no pod runs."""
    labels = {"app.kubernetes.io/name": name}
    container = {"name": "node", "image": "nowhere.invalid/node:1", "args": [said]}
    notes = {SINGLETON_ANNOTATION: "/talker"}
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {"name": name, "namespace": namespace, "annotations": notes},
        "spec": {
            "replicas": 0,
            "strategy": {"type": "Recreate"},
            "selector": {"matchLabels": labels},
            "template": {"metadata": {"labels": labels}, "spec": {"containers": [container]}},
        },
    }


def desire(namespace: str, version: int) -> Desired:
    """Return a release: its second version renames the node and replaces a ConfigMap."""
    objects = (
        config(namespace, "shared", version=str(version)),
        config(namespace, f"only-{version}"),
        claim(namespace),
        node(namespace, "talker" if version == 1 else "chatter", str(version)),
    )
    return Desired(ReleaseId(namespace, "demo"), objects, create_namespace=True)


def deploy_versions(*versions: int) -> Callable[[Cluster, str], object]:
    """Return a function that deploys versions of the release, one after the other."""

    def call(cluster: Cluster, namespace: str) -> None:
        for version in versions:
            part = Part(desired=desire(namespace, version))
            write_release(Run(part=part, cluster=cluster, options=OPTIONS))

    return call


def go_back(cluster: Cluster, namespace: str) -> None:
    """Roll the release back."""
    roll_back(cluster, ReleaseId(namespace, "demo"), None, OPTIONS)


def take_down(*, volumes: bool) -> Callable[[Cluster, str], object]:
    """Return a function that takes the release down."""

    def call(cluster: Cluster, namespace: str) -> None:
        down(cluster, ReleaseId(namespace, "demo"), OPTIONS, volumes=volumes)

    return call


def stop_pods(desired: Desired) -> Desired:
    """Return the same objects without pods: no replicas, and DaemonSets without a machine."""
    objects = []
    for manifest in desired.objects:
        spec = dict(manifest.get("spec") or {})
        if "replicas" in spec or manifest["kind"] in ("Deployment", "StatefulSet"):
            spec["replicas"] = 0
        if manifest["kind"] == "DaemonSet":
            template = spec["template"]
            chosen = {**template["spec"], "nodeSelector": {"bench.kills/no": "machine"}}
            spec["template"] = {**template, "spec": chosen}
        objects.append({**manifest, "spec": spec} if spec else manifest)
    return attrs.evolve(desired, objects=tuple(objects))


def ask_for_stack(namespace: str) -> StackRequest:
    """Return a request for a small stack of this namespace."""
    return request_of({**STACK, "namespace": namespace})


def install_stack(cluster: Cluster, namespace: str) -> None:
    """Install the stack as a job does, without its pods."""

    def without_pods(request: StackRequest, cluster: Cluster) -> Any:
        made = desired_stack(request, cluster)
        return attrs.evolve(made, desired=stop_pods(made.desired))

    vars(stacks)["desired_stack"] = without_pods
    deploy([stacks.stack_part(ask_for_stack(namespace), cluster)], cluster, OPTIONS)


def remove_stack(cluster: Cluster, namespace: str) -> None:
    """Remove the stack, and its objects outside of its namespace."""
    release = render_stack(ask_for_stack(namespace), namespace).release
    down(cluster, release, OPTIONS, volumes=True)
    for manifest in render_stack(ask_for_stack(namespace), namespace).desired.objects:
        if not manifest["metadata"].get("namespace"):
            cluster.delete(ref_of(manifest))


def nothing(cluster: Cluster, namespace: str) -> None:
    """Do nothing."""


SCENARIOS: Sequence[Scenario] = (
    Scenario("first deploy", "demo", nothing, deploy_versions(1)),
    Scenario("update, a node renamed", "demo", deploy_versions(1), deploy_versions(2)),
    Scenario("rollback", "demo", deploy_versions(1, 2), go_back),
    Scenario("down", "demo", deploy_versions(1, 2), take_down(volumes=False)),
    Scenario("down --volumes", "demo", deploy_versions(1, 2), take_down(volumes=True)),
    Scenario("observability stack", "rigel-observability", nothing, install_stack, remove_stack),
)


def clear(cluster: Cluster, scenario: Scenario, namespace: str) -> None:
    """Remove everything that an earlier scenario has left."""
    scenario.undo(cluster, namespace)
    down(cluster, ReleaseId(namespace, "demo"), OPTIONS, volumes=True)
    for kind in KINDS:
        for live in cluster.list(*kind, namespace):
            if not is_given(live):
                cluster.delete(ref_of(live))


def delete_namespace(cluster: Cluster, namespace: str) -> None:
    """Delete the namespace of the scenarios, and wait for its end.

    Raises:
        RuntimeError: it still exists after the time-out.
    """
    ref = ObjectRef("v1", "Namespace", "", namespace)
    cluster.delete(ref)
    end = time.monotonic() + GONE_TIMEOUT
    while cluster.get(ref) is not None:
        if time.monotonic() > end:
            raise RuntimeError(f"{ref} still exists after {GONE_TIMEOUT:g} s")
        time.sleep(1)


def run_again(scenario: Scenario, cluster: Cluster, namespace: str, wanted: Snapshot) -> str:
    """Run a command again after it was killed, and return the result.

    A complete rollback without a number is not repeated: it would return to an older revision.
    """
    found = take_snapshot(cluster, scenario, namespace)
    if found.is_as(wanted) and scenario.name == "rollback":
        return "was complete"
    try:
        scenario.command(cluster, namespace)
    except RigelK8sError as error:
        return f"WRONG: {error.message}"
    again = take_snapshot(cluster, scenario, namespace)
    if not again.is_as(wanted):
        return f"WRONG: {again} instead of {wanted}"
    return "was complete" if found.is_as(wanted) else "completed"

"""doctor: checks what a deploy needs, one by one, and what running nodes need of their machines."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import attrs

from rigel_k8s.app.rights import PURPOSES, read_rights
from rigel_k8s.commands import clocks
from rigel_k8s.commands.targets import list_namespaces
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.facts import is_default_class, is_ready
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.rights import Right, describe
from rigel_k8s.problems import Problem
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.refusals.missing import ask_missing
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings

CLOCKS = 5.0  # seconds that machines have to answer; those of `status` are fewer
#: A deploy needs no right to see them.
UNSEEN = "you have no right to list them, which a deploy does not need"


@attrs.frozen
class Need:
    """One thing that a deploy needs: its state, and the problem if it is missing."""

    what: str
    state: str
    problem: Problem | None = None


def examine(settings: Settings) -> list[Need]:
    """Return what a deploy needs; without a reachable cluster, nothing else is checked."""
    try:
        with connect(settings) as cluster:
            version = cluster.server_version()
            where = cluster.context_name or "in-cluster"
            namespaces = list_namespaces(settings, cluster)
            return [
                Need("cluster", f"{where} at {cluster.server}, {version}"),
                *(need for namespace in namespaces for need in rights(cluster, namespace)),
                nodes(cluster),
                storage(cluster),
                *compare_clocks(cluster, namespaces),
            ]
    except RigelK8sError as error:
        return [lack("cluster", error.message, error.hint or "")]


def lack(what: str, state: str, remedy: str) -> Need:
    """Return a need that is not met."""
    return Need(what, state, Problem((), f"{what}: {state}", what.partition(" ")[0], remedy=remedy))


def rights(cluster: Cluster, namespace: str) -> Iterator[Need]:
    """Report the missing rights: those that a deploy needs, then the optional ones."""
    every = read_rights(PURPOSES["deployer"], namespace)
    missing = set(ask_missing(cluster, every, namespace))
    needed = missing & read_rights(("deploy",), namespace)
    of_gate = missing & read_rights(("gate",), namespace)
    what = f"rights in {namespace}"
    if needed:
        yield lack(
            what,
            f"missing: {list_all(needed)}",
            f"print the Role to request with `rigel -n {namespace} rbac deployer --user YOU`",
        )
    else:
        yield Need(what, "all that a release needs")
    yield Need(
        f"rights for a gate in {namespace}",
        f"missing: {list_all(of_gate)}; ROS 1 needs `gate: false`, or these rights"
        if of_gate
        else "all that ROS 1's gate needs",
    )
    if rest := missing - needed - of_gate:
        state = f"missing: {list_all(rest)}; a deploy works without them, but explains less"
        yield Need(f"more rights in {namespace}", state)


def list_all(rights: Iterable[Right]) -> str:
    return "; ".join(describe(rights))


def nodes(cluster: Cluster) -> Need:
    """Report which machines are ready."""
    ready: list[str] = []
    other: list[str] = []
    try:
        there = cluster.nodes()
    except Forbidden:
        return Need("nodes", UNSEEN)
    for node in there:
        names = ready if is_ready(node) else other
        names.append(node["metadata"]["name"])
    state = f"{len(ready)} ready" + (f", not ready: {', '.join(other)}" if other else "")
    return Need("nodes", state) if ready else lack("nodes", state, "kubectl describe node NAME")


def storage(cluster: Cluster) -> Need:
    """Report the default StorageClass; without one, claims need a storage_class or host_path."""
    try:
        classes = cluster.list("storage.k8s.io/v1", "StorageClass")
    except Forbidden:
        return Need("storage", UNSEEN)
    default = [one["metadata"]["name"] for one in classes if is_default_class(one)]
    if default:
        return Need("storage", f"default class {default[0]}")
    return lack(
        "storage", "no default StorageClass", "set storage_class or host_path of each volume"
    )


def compare_clocks(cluster: Cluster, namespaces: Iterable[str]) -> Iterator[Need]:
    """Report machines of a release whose clocks differ, and this computer's if it does."""
    try:
        releases = {
            ReleaseId(namespace, pod["metadata"]["labels"][RELEASE_LABEL]): None
            for namespace in namespaces
            for pod in cluster.list(
                "v1", "Pod", namespace, labels=RELEASE_LABEL, metadata_only=True
            )
        }
        readings = [clocks.begin(cluster, list_pods(cluster, release)) for release in releases]
    except Forbidden:
        return
    found = [clocks.finish(reading, CLOCKS) for reading in readings]
    every = {machine: clock for one in found for machine, clock in one.items()}
    problems = [problem for one in found for problem in clocks.judge(one)]
    for problem in dict.fromkeys([*problems, *clocks.judge_own(every)]):
        yield Need("clocks", problem.message.removeprefix("clocks: "), problem)

"""Checks whether each machine has Multus, and the programs and kernel that an attachment needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rigel_k8s.network.multus.manifests import STANDARD
from rigel_k8s.network.preflight.attachments import Attachment
from rigel_k8s.network.preflight.case import Case
from rigel_k8s.network.preflight.finding import INSTALL, PreflightKind, group_by_text, list_some
from rigel_k8s.problems import Problem

MULTUS_MISSING = PreflightKind(
    "multus-missing",
    "the cluster has no NetworkAttachmentDefinition",
    "cluster",
    "the kinds of the API",
)
WHEREABOUTS_MISSING = PreflightKind(
    "whereabouts-missing",
    "`ipam: whereabouts`, and the cluster has no IPPool",
    "cluster",
    "the kinds of the API",
)
ATTACHMENT_MISSING = PreflightKind(
    "attachment-missing",
    "the named attachment does not exist",
    "Rigelfile",
    "NetworkAttachmentDefinitions of all namespaces",
)
MULTUS_NOT_ON_NODE = PreflightKind(
    "multus-not-on-node",
    "a machine has no Multus daemon",
    "cluster",
    "pods of DaemonSets with Multus' image or name",
)
MULTUS_NOT_READY = PreflightKind(
    "multus-not-ready",
    "a machine's daemon is not ready, so pods would start without net1",
    "cluster",
    "the pod's conditions",
)
PROGRAM_MISSING = PreflightKind(
    "program-missing",
    "a machine has no program macvlan, whereabouts, static or the like",
    "cluster",
    "the directory of CNI programs on the machine",
)
KERNEL = PreflightKind(
    "kernel",
    "the kernel was built without macvlan or ipvlan",
    "cluster",
    "`/proc/config.gz`, if the kernel has it",
)


def presence(case: Case) -> Iterator[Problem]:
    """Yield machines without Multus, and attachments that do not exist."""
    if not case.keys:
        return
    if not case.view.multus:
        yield MULTUS_MISSING.problem(
            "Multus is not installed: the cluster has no kind NetworkAttachmentDefinition",
            INSTALL,
        )
        return
    if not case.view.whereabouts and any(one.ipam == "whereabouts" for one in case.attachments):
        yield WHEREABOUTS_MISSING.problem(
            "whereabouts is not installed: the cluster has no kind IPPool",
            f"{INSTALL}; or use another `network.ipam`",
        )
    yield from _check_daemons(case)
    known = {*case.view.attachments, *case.own, *case.view.unread}
    there = list_some(sorted(case.view.attachments)) or "none"
    for key in (key for key in case.keys if key not in known):
        yield ATTACHMENT_MISSING.problem(
            f"the NetworkAttachmentDefinition {key} does not exist (the cluster has: {there})",
            "set `network.attachment` to an existing one, as NAMESPACE/NAME, or create it",
        )


def _check_daemons(case: Case) -> Iterator[Problem]:
    """Yield the machines whose Multus is missing or not ready; unreachable ones are skipped."""
    if case.view.daemons is None:
        return
    nodes = [node for node in case.nodes() if node in case.ready]
    missing = [node for node in nodes if node not in case.view.daemons]
    if missing:
        yield MULTUS_NOT_ON_NODE.problem(
            f"no Multus daemon runs on {list_some(missing)}, where pods of the release may run",
            f"{INSTALL}; or keep the pods away from these machines with `placement`",
        )
    for node in nodes:
        daemon = case.view.daemons.get(node)
        if daemon and daemon.state:
            yield MULTUS_NOT_READY.problem(
                f"the Multus daemon on {node} is not ready: {daemon.state}",
                f"kubectl -n {daemon.namespace} logs {daemon.pod} -c {daemon.container}",
            )


def programs(case: Case) -> Iterator[Problem]:
    """Yield CNI programs and parts of the kernel that are missing on machines."""
    for one in case.attachments:
        yield from _check_programs(case, one)
        yield from _check_kernel(case, one)


def _check_programs(case: Case, one: Attachment) -> Iterator[Problem]:
    needed = dict.fromkeys(one.programs)
    missing: dict[str, str] = {}
    remedies: dict[str, str] = {}
    for node, facts in case.machines(one):
        there = frozenset().union(*facts.programs.values())
        names = [name for name in needed if name not in there] if facts.programs else []
        if names:
            missing[node] = f"{list_some(names)} (looked into {list_some(facts.programs)})"
            remedies[missing[node]] = _suggest_source(names)
    for text, nodes in group_by_text(missing).items():
        message = f"CNI programs are missing on {list_some(nodes)}: {text}"
        yield PROGRAM_MISSING.problem(message, remedies[text])


def _suggest_source(names: Sequence[str]) -> str:
    """Return how to install CNI programs; on some platforms `install` brings the standard ones."""
    if set(names) <= {"whereabouts"}:
        return INSTALL
    if set(names) <= {"whereabouts", *STANDARD.split()}:
        return (
            "on k3s and kind, set `network: {install: true}`; elsewhere, set"
            " `network.install.plugins_image` to an image that has them, or unpack the CNI plugins'"
            " release in that directory"
        )
    return "put them into that directory on each of these machines"


def _check_kernel(case: Case, one: Attachment) -> Iterator[Problem]:
    nodes = [node for node, facts in case.machines(one) if facts.kernel.get(one.program) is False]
    if nodes:
        yield KERNEL.problem(
            f"the kernel of {list_some(nodes)} was built without {one.program}",
            f"install a kernel with CONFIG_{one.program.upper()},"
            " or use `mode: peers` or `discovery-server`",
        )

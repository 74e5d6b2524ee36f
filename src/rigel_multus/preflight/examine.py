"""Checks before a deploy whether the release's network can work on its cluster.

It examines the cluster (look.py) and passes the results to the pure checks of this package. Nothing
is installed, written or changed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rigel_k8s.errors import ClusterError, RigelK8sError, UserError
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.problems import Problem
from rigel_multus.preflight.attachments import KIND, read_attachment
from rigel_multus.preflight.case import Case, find_wanted
from rigel_multus.preflight.checks import KINDS, find_problems

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

#: Findings about Multus itself and the programs that its installation brings.
MENDED = (
    "multus-missing",
    "whereabouts-missing",
    "multus-not-on-node",
    "multus-not-ready",
    "program-missing",
    "unseen",
)


def inspect(
    objects: Iterable[Mapping[str, Any]],
    network: Network | None,
    cluster: Cluster,
    *,
    mended: bool = False,
) -> tuple[RigelK8sError | None, tuple[str, ...]]:
    """Return why the network cannot work, and what may go wrong; docs/errors.md lists them.

    Args:
        objects: all manifests of the release.
        network: the job's `network`.
        mended: leave out what an installation of Multus will mend.

    Returns:
        A UserError if a finding needs a change of the Rigelfile, a ClusterError if something is
        missing on the cluster; it contains all findings that are errors.
    """
    found = examine(objects, network, cluster)
    found = [problem for problem in found if not (mended and problem.kind in MENDED)]
    return (
        failure([problem for problem in found if problem.is_error]),
        tuple(problem.text for problem in found if not problem.is_error),
    )


def examine(
    objects: Iterable[Mapping[str, Any]], network: Network | None, cluster: Cluster
) -> list[Problem]:
    """Return everything that keeps a release's network from working, or may."""
    if network is None or not mode_of(network).on_machines:
        return []
    manifests = list(objects)
    brought = (read_attachment(item) for item in manifests if item.get("kind") == KIND)
    case = Case(network, list(find_wanted(manifests)), {one.key: one for one in brought})
    if not (case.keys or (case.wanted and network.interface)):
        return []
    from rigel_multus.preflight.look import look

    case, unseen = look(case, cluster)
    return [*find_problems(case), *unseen]


def failure(errors: Sequence[Problem]) -> RigelK8sError | None:
    """Return one error with all findings, None if there are none."""
    if not errors:
        return None
    changes = {KINDS[problem.kind].changes for problem in errors}
    failed = UserError if "Rigelfile" in changes else ClusterError
    if len(errors) == 1:
        return failed(f"{errors[0].message} [{errors[0].kind}]", hint=errors[0].remedy)
    return failed(
        f"{len(errors)} things keep the network of this release from working",
        details=[line for problem in errors for line in problem.lines()],
        hint="nothing was changed; `rigel explain KIND` explains the word in brackets",
    )

"""What joins an application, its deploy, status and tests, without being known here.

Guests are found by entry points, `rigel_k8s.parts`. Imports are late: `rigel explain` asks, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import attrs

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.installed import find, list_names

if TYPE_CHECKING:
    from rigel_k8s.app.options import OrchestrationOptions
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Hooks, Inspection, Part, Run
    from rigel_k8s.release.status import ReleaseStatus
    from rigel_k8s.report import Reporter
    from rigel_k8s.settings import Application, Settings

#: How a test ended. Unknown is what could not be measured, which breaks nothing.
State: TypeAlias = Literal["passed", "failed", "unknown"]


@attrs.frozen
class DeployRequest:
    """The deploy of an application, as its job requests it.

    Attributes:
        raw: the options that are set, as plain data.
        cluster: None for `render`: as far as the Rigelfile describes it.
        settings: those of this run, such as `now`.
    """

    options: OrchestrationOptions
    raw: Mapping[str, Any]
    cluster: Cluster | None
    report: Reporter
    application: Application
    settings: Settings


@attrs.frozen(kw_only=True)
class StatusAddition:
    """What a guest adds to `rigel status`, as plain values.

    Attributes:
        heads: of its columns.
        cells: a pod's, by its name; POD/NODE where several nodes are in it.
        lines: what is wrong.
        notes: what is good to know.
        json: parts of the JSON, by their keys.
        ok: False for an exit code of 1.
    """

    heads: Sequence[str] = ()
    cells: Mapping[str, Sequence[str]] = attrs.field(factory=dict)
    lines: Sequence[str] = ()
    notes: Sequence[str] = ()
    json: Mapping[str, Any] = attrs.field(factory=dict)
    ok: bool = True

    def find_cells(self, pod: str, node: str) -> Sequence[str]:
        """Return the cells of a node's pod."""
        return self.cells.get(pod) or self.cells.get(f"{pod}/{node}") or ["-"] * len(self.heads)


class Guest:
    """What a package adds to applications; this one adds nothing."""

    def parts(self, request: DeployRequest) -> Sequence[Part]:
        """Return what the options request beside the application; nothing is written."""
        return ()

    def inspect(
        self,
        objects: Iterable[Mapping[str, Any]],
        options: OrchestrationOptions,
        cluster: Cluster,
        *,
        mended: bool,
    ) -> Inspection | None:
        """Return what keeps the application from working on this cluster, or may.

        Args:
            objects: the application's manifests.
            mended: a part of rank "network" is written before; leave out what it mends.
        """
        return None

    def hooks(self, request: DeployRequest) -> Hooks | None:
        """Return what is called beside the application's own hooks, from `before_pods` on."""
        return None

    def status(self, cluster: Cluster, release: ReleaseStatus) -> StatusAddition | None:
        """Return what it sees of a running release; it may run programs in pods."""
        return None

    def test(self, run: Run, wait: float) -> Iterable[tuple[str, State, str]]:
        """Return (name, how it ended, why) of what `rigel test` tests of a running release.

        Args:
            wait: seconds that it may take to pass.
        """
        return ()

    def kinds(self) -> Iterable[tuple[str, str, str]]:
        """Return (word, cause, where the answer comes from) of what `inspect` finds; Markdown."""
        return ()


def load_guests() -> list[Guest]:
    """Return all, in the order of their names.

    Raises:
        UserError: one cannot be imported.
        RigelK8sError: without any, a deploy would leave out what the Rigelfile requests.
    """
    names = sorted(list_names("rigel_k8s.parts"))
    if not names:
        raise RigelK8sError(
            "this installation of rigel-k8s has no entry points",
            hint="install it again; a checkout with `pip install -e .`",
        )
    return [find("rigel_k8s.parts", name) for name in names]

"""What joins the deploy of an application without being known here.

Guests are found by entry points, `rigel_k8s.parts`. Imports are late: `rigel explain` asks, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.installed import find, list_names

if TYPE_CHECKING:
    from rigel_k8s.app.options import OrchestrationOptions
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Hooks, Inspection, Part
    from rigel_k8s.report import Reporter
    from rigel_k8s.settings import Application, Settings


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


class Guest:
    """What a package adds to each deploy of an application; this one adds nothing."""

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
        """Return what to call at the same moments as the application's own hooks."""
        return None

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

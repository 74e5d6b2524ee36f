"""What Multus adds to a deploy: its installation, and a look at the machines' networks before."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rigel_k8s.app.deploying.guests import DeployRequest, Guest

if TYPE_CHECKING:
    from rigel_k8s.app.options import OrchestrationOptions
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Inspection, Part


class MultusGuest(Guest):
    """The preflight, and an installation where `network` requests it."""

    def parts(self, request: DeployRequest) -> Sequence[Part]:
        """Return the installation that `network` requests; only modes with Multus can."""
        network = request.options.network
        if network is None or network.install is None:
            return ()
        from rigel_multus.install import requested_multus

        return requested_multus(network, request.cluster, request.report)

    def inspect(
        self,
        objects: Iterable[Mapping[str, Any]],
        options: OrchestrationOptions,
        cluster: Cluster,
        *,
        mended: bool,
    ) -> Inspection:
        """Return what the preflight finds."""
        from rigel_k8s.release.part import Inspection
        from rigel_multus.preflight.examine import inspect

        error, warnings = inspect(objects, options.network, cluster, mended=mended)
        return Inspection((error,) if error else (), warnings)

    def kinds(self) -> Iterable[tuple[str, str, str]]:
        """Return the kinds of the preflight's findings."""
        from rigel_multus.preflight.checks import KINDS

        return [(kind.name, kind.cause, kind.found_by) for kind in KINDS.values()]


GUEST = MultusGuest()

"""One deploy from start to end, as a value that apply, wait and record share."""

from __future__ import annotations

from collections.abc import Callable

import attrs

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.types import DeployOptions, Desired, Plan, ReleaseId
from rigel_k8s.report import Reporter


@attrs.frozen(kw_only=True)
class Run:
    """What is deployed, where and how.

    Attributes:
        back_to: the revision that it deploys again; None for a deploy.
        keep: objects that stay as they are.
        away: the names of machines whose pods are not waited for.
        before: called with the plan when the Lease is held and nothing is written yet.
        applied: called when all objects are stored, and only the wait for them remains.
        verify: called when all is ready and pruned; if it raises, the revision is a failed one.
    """

    cluster: Cluster
    desired: Desired
    options: DeployOptions
    patience: Patience = attrs.field(factory=Patience)
    back_to: int | None = None
    keep: frozenset[ObjectRef] = frozenset()
    away: frozenset[str] = frozenset()
    before: Callable[[Plan], None] | None = None
    applied: Callable[[], None] | None = None
    verify: Callable[[], None] | None = None

    @property
    def release(self) -> ReleaseId:
        """The release."""
        return self.desired.release

    @property
    def report(self) -> Reporter:
        """Where it reports to."""
        return self.options.report

    def choose_way_out(self, good: int) -> str:
        """Return what else to do after it has failed or was interrupted, as a sentence.

        Args:
            good: the newest revision that became ready, 0 for none.
        """
        if self.back_to is None and good:
            command = self.options.write_command("rollback", self.release)
            return f"{command} goes back to revision {good}"
        return f"{self.options.write_command('status', self.release)} shows its state"

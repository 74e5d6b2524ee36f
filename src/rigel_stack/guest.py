"""What the stack adds to a deploy: itself, if the job requests it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rigel_k8s.app.deploying.guests import DeployRequest, Guest

if TYPE_CHECKING:
    from rigel_k8s.release.part import Part


class StackGuest(Guest):
    """An application works without the stack, so nothing is inspected."""

    def parts(self, request: DeployRequest) -> Sequence[Part]:
        """Return the stack that `observability` requests."""
        if not request.options.observability.enabled:
            return ()
        from rigel_k8s.observability.options import request_of
        from rigel_stack.install import requested_stack, stack_part

        stack = request_of(request.raw.get("observability") or {})
        if request.options.observability_only:
            return [stack_part(stack, request.cluster)]
        return requested_stack(stack, request.cluster, request.report)


GUEST = StackGuest()

"""What a container requests, and its limits, as every job type writes it."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.scalars import LabelKey, Quantity


@attrs.frozen(kw_only=True)
class Resources:
    """What a container requests, and its limits."""

    requests: Mapping[LabelKey, Quantity] = option(
        "by resource: cpu, memory, nvidia.com/gpu ...", {}
    )
    limits: Mapping[LabelKey, Quantity] = option("by resource", {})

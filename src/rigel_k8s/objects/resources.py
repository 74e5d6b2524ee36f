"""What a container asks for and may use at most, as every job type writes it."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.scalars import LabelKey, Quantity


@attrs.frozen(kw_only=True)
class Resources:
    """What a container asks for and may use at most."""

    requests: Mapping[LabelKey, Quantity] = option(
        "by resource: cpu, memory, nvidia.com/gpu ...", {}
    )
    limits: Mapping[LabelKey, Quantity] = option("by resource", {})

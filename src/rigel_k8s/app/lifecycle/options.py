"""Which transitions a lifecycle node makes; independent of Kubernetes objects."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from typing import Literal

import attrs

from rigel_k8s.objects.fields import option

Transition = Literal["configure", "activate", "deactivate", "cleanup", "shutdown"]


@attrs.frozen(kw_only=True)
class Lifecycle:
    """The transitions of a lifecycle node (a managed node)."""

    start: list[Transition] = option(
        "at its start, one after the other; the pod is ready when the last one is made", []
    )
    stop: list[Transition] = option("before its pod ends", [])

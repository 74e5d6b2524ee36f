"""How pods are replaced: at most one pod of a ROS name by default, no gap where names differ."""

from __future__ import annotations

from rigel_k8s.objects.podoptions import RollingUpdate
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.scalars import Share


def is_rolling(update: RollingUpdate | None) -> bool:
    """Return whether somebody asks for an update by surge, src.plugin's default."""
    if update is None:
        return False
    if update.strategy is None:
        return update.max_surge is not None or update.max_unavailable is not None
    return update.strategy.lower() != "recreate"


def strategy(update: RollingUpdate | None, *, anonymous: bool) -> Object:
    """Return the Deployment's strategy."""
    asked = update or RollingUpdate()
    recreate = asked.strategy is not None and asked.strategy.lower() == "recreate"
    if recreate or not (anonymous or is_rolling(update)):
        return {"type": "Recreate"}
    numbers = {
        "maxSurge": share(asked.max_surge, 1),
        "maxUnavailable": share(asked.max_unavailable, 0),
    }
    return {"type": "RollingUpdate", "rollingUpdate": numbers}


def share(value: Share | None, default: int) -> int | str:
    """Return a number of pods, or a percentage, as the Kubernetes field takes it."""
    return default if value is None else value.value

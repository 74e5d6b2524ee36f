"""Jobs that describe only a part of a release, as src.plugin's update_k8s does; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.objects.overlay import merge, simplify
from rigel_k8s.rigelfile.fields import fields_by_key

#: A job with one of these describes a whole release.
WHOLE = ("nodes", "application_image", "deploy_ros_master")
#: Options whose parts belong together: a mix of an old and a new one would be invalid.
AS_ONE = ("readiness", "rolling_update", "results")


def flat(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return a job's `with` without src.plugin's extra level, as plain data."""
    result: dict[str, Any] = simplify(raw)
    nested = result.pop(OrchestrationOptions.nested_under, None)
    return {**(nested or {}), **result}


def is_partial(raw: Mapping[str, Any]) -> bool:
    """Return whether a job describes only how a release differs from its last revision."""
    keys = flat(raw).keys()
    added = keys - fields_by_key(OrchestrationOptions).keys()  # they stand for nodes
    return not added and keys.isdisjoint(WHOLE)


def overlay(previous: Mapping[str, Any], raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a release's last revision with a partial job's merged in."""
    part = flat(raw)
    kept = {key: v for key, v in flat(previous).items() if key not in AS_ONE or key not in part}
    result: dict[str, Any] = merge(kept, part)
    return result

"""Options of an orchestration job from plain data, as a Rigelfile would give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.rigelfile.source import Span, YamlNode, node_of
from rigel_k8s.rigelfile.structure import structure


def options(raw: Mapping[str, Any]) -> OrchestrationOptions:
    """Return a job's `with` as options; a mistake in it fails the test."""
    found = structure(node_of(dict(raw), YamlNode({}, Span(1, 1, 1, 1))), OrchestrationOptions)
    assert not found.problems, found.problems
    assert isinstance(found.draft, OrchestrationOptions)
    return found.draft

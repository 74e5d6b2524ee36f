"""What one job says of the observability stack, which all applications of a cluster share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.objects.overlay import simplify

#: What is one application's own, or where the stack is and not what it is.
OWN = ("enabled", "ros_metrics", "namespace")


@attrs.frozen
class StackRequest:
    """What a job wants of the stack.

    It stays plain data, since only what is said changes a stack: others' words are merged below it,
    and become options once, together.

    Attributes:
        said: the options that the job gives, without what is its own; no password is in them.
        namespace: where it wants the stack to be, None for wherever it is.
        password: Grafana's, None to have one made.
    """

    said: Mapping[str, Any]
    namespace: str | None = None
    password: str | None = attrs.field(default=None, repr=False)


def request_of(raw: Mapping[str, Any]) -> StackRequest:
    """Return what a job's `observability`, as plain data, says of the stack."""
    said: dict[str, Any] = {key: value for key, value in simplify(raw).items() if key not in OWN}
    password = None
    if isinstance(said.get("grafana"), dict):
        password = said["grafana"].pop("admin_password", None)
    namespace = raw.get("namespace")
    return StackRequest(
        said,
        str(namespace) if namespace else None,
        str(password) if password else None,
    )

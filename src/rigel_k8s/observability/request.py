"""What one job requests of the observability stack, which all applications of a cluster share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.objects.overlay import simplify

#: Options of a single application, and where the stack is instead of what it is.
OWN = ("enabled", "ros_metrics", "namespace")


@attrs.frozen
class StackRequest:
    """What a job requests of the stack.

    It stays plain data, since only options that are set change a stack: it is merged over the data
    of other jobs, and all together become options.

    Attributes:
        options: those that the job sets for the stack, without a password.
        namespace: the stack's namespace, None for that of the existing stack.
        password: Grafana's, None to create one.
    """

    options: Mapping[str, Any]
    namespace: str | None = None
    password: str | None = attrs.field(default=None, repr=False)


def request_of(raw: Mapping[str, Any]) -> StackRequest:
    """Return what a job's `observability`, as plain data, requests of the stack."""
    options: dict[str, Any] = {key: value for key, value in simplify(raw).items() if key not in OWN}
    password = None
    if isinstance(options.get("grafana"), dict):
        password = options["grafana"].pop("admin_password", None)
    namespace = raw.get("namespace")
    return StackRequest(
        options,
        str(namespace) if namespace else None,
        str(password) if password else None,
    )

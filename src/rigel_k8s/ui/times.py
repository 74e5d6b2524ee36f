"""Times as Kubernetes writes them."""

from __future__ import annotations

from datetime import datetime, timezone


def write_now() -> str:
    """Return the present time as Kubernetes writes it."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")

"""One Rigelfile in, a running and observable ROS application on Kubernetes out."""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Return what Rigelfiles name `rigel_k8s.NAME` (`OrchestrationPlugin` and so on), lazily."""
    if not name.endswith(("Plugin", "Provider")):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from rigel_k8s.compat.plugin import public

    return public(name)

"""One Rigelfile in, a running and observable ROS application on Kubernetes out."""

from __future__ import annotations

__version__ = "0.1.0"

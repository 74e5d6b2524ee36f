"""The one way from this package to rigel_lab: local clusters, and images made from packages.

Import it late, where it is needed: most commands run on an existing cluster.
"""

from __future__ import annotations

from rigel_lab import cluster
from rigel_lab.cluster import ClusterStatus
from rigel_lab.images import exporter, mutoagent, ros1base
from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.base.delivery import deliver

__all__ = ["BaseImage", "ClusterStatus", "cluster", "deliver", "exporter", "mutoagent", "ros1base"]

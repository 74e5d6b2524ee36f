"""The one way from this package to rigel_lab: local clusters, and images made from packages.

Import it late, where it is needed: most commands run on an existing cluster.
"""

from __future__ import annotations

from rigel_lab import cluster
from rigel_lab.cluster import ClusterStatus
from rigel_lab.cluster.oci import push_archive
from rigel_lab.images import exporter, mutoagent, ros1base, ros2base
from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.base.engine import forget as forget_image
from rigel_lab.images.base.engine import load as load_image
from rigel_lab.images.base.engine import push as push_image

__all__ = [
    "BaseImage",
    "ClusterStatus",
    "cluster",
    "exporter",
    "forget_image",
    "load_image",
    "mutoagent",
    "push_archive",
    "push_image",
    "ros1base",
    "ros2base",
]

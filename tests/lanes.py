"""Which tests run one after the other where several processes share the work.

Tests of a cluster mostly wait, so several processes run them side by side, each with a cluster of
its own. Tests that need the same costly things (a stack, images, a machine to compare) are one lane
and stay in one process, in their usual order; any other file is a lane of its own.
"""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parent
#: The beginning of a path -> its lane; the first that fits counts.
LANES = {
    "cluster/observability/": "observability",
    "cluster/ros2/": "ros2",
    "cluster/localcluster/": "machines",
    "cluster/network/test_k3s_guide.py": "machines",
    "cluster/network/test_own_cluster.py": "machines",
    "cluster/network/test_preflight_own.py": "machines",
    "cluster/": "applications",
    "ros1/": "ros1",
    "ros2/": "ros2-in-namespaces",
}
#: Seconds: the first test of a lane may wait for builds.
BUILDS = 3600


def lane_of(path: Path) -> str:
    """Return the lane of a test file."""
    name = path.relative_to(ROOT).as_posix()
    return next((lane for start, lane in LANES.items() if name.startswith(start)), name)

"""Which tests run one after the other where several processes share the work.

Tests of a cluster mostly wait, so several processes run them side by side, each with a cluster of
its own. Tests that need the same costly things (a stack, images, a machine to compare) are one lane
and stay in one process, in their usual order; any other file is a lane of its own.
"""

from __future__ import annotations

from xdist.scheduler import LoadScopeScheduling

#: The beginning of a path -> its lane; the first that fits counts.
LANES = {
    "tests/cluster/observability/": "observability",
    "tests/cluster/ros2/": "ros2",
    "tests/cluster/localcluster/": "machines",
    "tests/cluster/network/test_k3s_guide.py": "machines",
    "tests/cluster/network/test_own_cluster.py": "machines",
    "tests/cluster/network/test_preflight_own.py": "machines",
    "tests/cluster/": "applications",
    "tests/ros1/": "ros1",
    "tests/ros2/": "ros2-in-namespaces",
}
#: Seconds: the first test of a lane may wait for builds.
BUILDS = 3600


class Lanes(LoadScopeScheduling):
    """Gives each process a lane, and another when it is through with it."""

    def _split_scope(self, nodeid: str) -> str:
        return lane_of(nodeid)


def lane_of(nodeid: str) -> str:
    """Return the lane of a test."""
    file = nodeid.split("::")[0]
    return next((lane for start, lane in LANES.items() if file.startswith(start)), file)

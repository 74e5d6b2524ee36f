"""Which tests run one after the other where several processes share the work.

Each process has a cluster of its own. Tests that need the same costly things (a stack, images, a
machine to compare) are one lane and stay in one process, in their usual order; any other file is a
lane of its own. While one builds, the others go on.

usage: python -m tests.lanes    prints how many processes to take
"""

from __future__ import annotations

from xdist.scheduler import LoadScopeScheduling

from rigel_lab.cluster.components import ON_REQUEST
from rigel_lab.cluster.releases import Upstream

#: The beginning of a path -> its lane; the first that fits counts.
LANES = {
    "tests/cluster/observability/": "observability",
    "tests/cluster/ros2/": "ros2",
    "tests/cluster/lab/": "machines",
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


def processes() -> int:
    """Return how many processes to take: none besides the first where all programs are built."""
    builds, upstream = [build for some in ON_REQUEST.values() for build in some], Upstream.of(None)
    return 0 if all(build.find(upstream) for build in builds) else 3


if __name__ == "__main__":
    print(processes())  # noqa: T201

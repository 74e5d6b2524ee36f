"""Which tests run one after the other where several processes share the work, and which begin.

A lane is what one process runs in one go, in the usual order: a file, or all files below a path in
LANES. Tests are in one lane where they use the same cluster-wide thing (the observability stack,
Multus' release, metrics.k8s.io, the operator, a range of addresses) or a costly one of their own.

This is what `--dist loadgroup` does with `xdist_group` marks, which pytest 9.2 broke
(pytest-dev/pytest-xdist#1386): all marked tests would be spread, without a word.
"""

from __future__ import annotations

from xdist.scheduler import LoadScopeScheduling

#: The beginning of a path -> its lane, in the order in which they begin. The longest counts.
LANES = {
    "tests/cluster/observability/test_src_plugin.py": "stack",  # wants that none is there
    "tests/cluster/observability/test_stack.py": "stack",
    "tests/cluster/observability/test_existing_loki.py": "stack",
    "tests/cluster/ros2/": "ros2",
    # With static peers, in namespaces of their own: beside the others.
    "tests/cluster/ros2/test_foxglove.py": "ros2 peers",
    "tests/cluster/ros2/test_ros2_expect.py": "ros2 peers",
    "tests/cluster/ros2/test_ros2_task.py": "ros2 peers",
    "tests/cluster/ros2/test_ros2_testing.py": "ros2 peers",
    "tests/cluster/ros2/test_ros2_together.py": "ros2 peers",
    "tests/cluster/ros2/modes/": "ros2 modes",
    "tests/cluster/network/test_own_cluster.py": "own cluster",  # leaves it as it was
    "tests/cluster/network/test_preflight_own.py": "own cluster",  # wants no Multus, leaves it
    "tests/cluster/network/test_k3s_guide.py": "own cluster",
    "tests/cluster/lab/": "machines",
    "tests/cluster/network/": "network",
    "tests/cluster/observability/boards/": "boards",
    "tests/cluster/observability/test_exporter.py": "exporter",
    "tests/cluster/observability/reading/": "reading",
    "tests/cluster/observability/test_existing.py": "operator",
}
#: Lane -> the lane that has to be over when it begins, because that one changes the stack.
AFTER = dict.fromkeys(("boards", "exporter", "reading", "operator"), "stack")
#: What begins while the shared cluster starts; what needs no cluster and fills the gaps at the end.
FIRST, LAST = "tests/unit/", ("tests/ros1/", "tests/ros2/")


class Lanes(LoadScopeScheduling):
    """Gives each process a lane, and another when it is through with it."""

    def _split_scope(self, nodeid: str) -> str:
        return lane_of(nodeid)


def lane_of(nodeid: str) -> str:
    """Return the lane of a test."""
    return LANES.get(start_of(nodeid)) or nodeid.split("::")[0]


def start_of(nodeid: str) -> str:
    """Return the longest beginning of a test's path that stands in LANES, "" for none."""
    return max(filter(nodeid.startswith, LANES), key=len, default="")


def turn_of(nodeid: str) -> tuple[int, int]:
    """Return when a test's turn is: the smaller, the earlier."""
    if nodeid.startswith(FIRST):
        return (0, 0)
    if nodeid.startswith(LAST):
        return (2, 0)
    starts = list(LANES)
    return (1, starts.index(start) if (start := start_of(nodeid)) else len(starts))

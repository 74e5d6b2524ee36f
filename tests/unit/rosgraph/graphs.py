"""Graphs to draw."""

from __future__ import annotations

import random

from rigel_graph.commands.graph import LiveGraph
from rigel_graph.problems import find_problems
from rigel_graph.types import GraphNode, GraphService, GraphTopic, Mismatch, RosGraph
from rigel_k8s.release.types import ReleaseId

ROBOT = RosGraph(
    nodes=(
        GraphNode("/base", "robot", "base-7d9f8c6b5d-k2j4x", "base"),
        GraphNode("/controller", "edge", "controller-66c4d5f7b8-9qwzx", "controller"),
        GraphNode("/imu", "robot", "imu-5f6d7c8b9-zzx2v", "imu", registered=False, up=False),
        GraphNode("/lidar", "robot", "lidar-54f6b7c9d8-abcde", "lidar"),
        GraphNode("/planner", "edge", "planner-7c9b8d6f5-hjklm", "planner", up=False),
        GraphNode("/rosout", "edge", "ros-master-5b7c-xyz12", "ros-master"),
        GraphNode("/rviz", address="10.0.0.7"),
    ),
    topics=(
        GraphTopic("/cmd_vel", "geometry_msgs/msg/Twist", ("/controller",), ("/base",), rate=20.0),
        GraphTopic("/goal", "geometry_msgs/msg/PoseStamped", (), ("/planner",)),
        GraphTopic("/odom", "nav_msgs/msg/Odometry", ("/base",), ("/controller", "/planner")),
        GraphTopic(
            "/plan/_action/feedback",
            "nav2_msgs/action/Plan_FeedbackMessage",
            ("/planner",),
            ("/controller",),
        ),
        GraphTopic("/plan/_action/status", "action_msgs/msg/GoalStatusArray", ("/planner",)),
        GraphTopic("/rosout", "rcl_interfaces/msg/Log", ("/base", "/lidar"), ("/rosout",)),
        GraphTopic(
            "/scan",
            "sensor_msgs/msg/LaserScan",
            ("/lidar",),
            ("/planner", "/rviz"),
            (Mismatch("/rviz", "sensor_msgs/msg/PointCloud2"),),
            rate=9.98,
        ),
    ),
    services=(GraphService("/base/reset", "std_srvs/srv/Empty", ("/base",)),),
)
#: Names that mean something to SVG and DOT.
ODD = RosGraph(
    nodes=(GraphNode('/a"<b>&#`\\', 'no"de<1>', "a&b"), GraphNode("/c", "node2", "c-1")),
    topics=(GraphTopic('/t"<x>&#`\\', 'T"<>', ('/a"<b>&#`\\',), ("/c",)),),
)


def live(graph: RosGraph) -> LiveGraph:
    """Return a graph with what is wrong in it."""
    return LiveGraph(ReleaseId("robots", "explorer"), graph, find_problems(graph))


def make_random(seed: int, nodes: int = 60, machines: int = 5) -> RosGraph:
    """Return a graph of chance, with cycles; the same for the same seed."""
    chance = random.Random(seed)
    names = [f"/robot{n % 4}/{'long_' * chance.randrange(6)}node_{n}" for n in range(nodes)]
    found = [GraphNode(n, f"node{chance.randrange(machines)}", f"pod-{n[1:]}") for n in names]
    topics = []
    for number in range(nodes):
        name = f"/topic_{number}/{'long_' * chance.randrange(8)}x"
        senders = tuple(sorted(chance.sample(names, chance.choice([0, 1, 1, 1, 2]))))
        hearers = tuple(sorted(chance.sample(names, chance.choice([0, 1, 1, 2, 3]))))
        topics.append(GraphTopic(name, "std_msgs/msg/String", senders, hearers))
    kept = tuple(topic for topic in topics if topic.publishers or topic.subscribers)
    return RosGraph(tuple(sorted(found, key=lambda node: node.name)), kept)

"""A ROS 2 application over a second network, with the whole stack: the example, watched.

The rules' `for` is not waited for here: that an alert fires after it, boards/test_alerts.py sees.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import pytest

from ..ros2.conftest import EXAMPLES, Project, projects
from .boards import asking
from .boards.conftest import Samples, Watch, inside, until

pytestmark = pytest.mark.cluster

SCRIPTS = EXAMPLES / "ros2-talker-listener" / "talker_listener" / "scripts"
LIDAR = (Path(__file__).parent / "lidar.py").read_text()
NODES = {"/talker_1", "/talker_2", "/listener", "/lidar", "/victim"}
#: Its container outlives it, and its pod is always Ready.
OUTLIVED = 'python3 -c "$0" --ros-args -r __node:=victim -r scan:=beat; sleep 100000'
STRING = "std_msgs/msg/String"
#: Queries that find nothing, and why.
EMPTY = {
    "missing_registrations": "a column that ROS 1 has, beside others",
    'ALERTS{alertstate="firing"': "not until an alert's `for` has passed",
}
#: What a panel without data says where ROS 2 has nothing to tell, or nobody asked for it.
SAID = re.compile(r"only available in ROS 1|not enabled|no named topic has a header")
BOARDS = ("rigel-applications", "rigel-ros-graph", "rigel-logs")


@attrs.frozen
class Watched:
    """The application, and the stack that watches it."""

    project: Project
    watch: Watch

    def samples(self, metric: str, **labels: str) -> Samples:
        """Return what Prometheus has of the application now."""
        own = {"namespace": self.project.space, **labels}
        chosen = ", ".join(f"{name}={json.dumps(value)}" for name, value in own.items())
        return self.watch.now(f"{metric}{{{chosen}}}")

    def values(self, metric: str, by: str, **labels: str) -> dict[str, float]:
        """Return them by one of their labels."""
        found = self.samples(metric, **labels)
        return {one["metric"].get(by, ""): float(one["value"][1]) for one in found}

    def entries(self, selector: str) -> list[tuple[dict[str, str], str]]:
        """Return Loki's entries of the application, each with its labels."""
        query = f'{{namespace="{self.project.space}", {selector}}}'
        streams = self.watch.loki("query_range", query=query, limit=1000)["result"]
        return [(one["stream"], text) for one in streams for _, text in one["values"]]

    def top(self, *words: str) -> dict[str, dict[str, Any]]:
        """Return what `rigel top` tells of nodes, or of topics, by name."""
        told = json.loads(self.project("top", "-o", "json", *words).stdout)
        return {
            row.get("name") or row["ros_name"]: row for row in told.get("topics", told.get("nodes"))
        }

    def alerts(self, name: str) -> Sequence[dict[str, str]]:
        """Return the labels of an alert's cases, that fire or wait for their time."""
        return [one["metric"] for one in self.samples("ALERTS", alertname=name)]


def example(options: dict[str, Any], *, exporter: str) -> None:
    """Make the example's job one of the base image, with a lidar, and watched."""
    base = "{{ vars.BASE_IMAGE }}"
    for name, node in options["nodes"].items():
        script = SCRIPTS / f"{name.rpartition('_')[0] or name}.py"
        node.update(image=base, args=["python3", "-c", script.read_text()])
    lidar = {"image": base, "args": ["python3", "-c", LIDAR]}
    victim = {"image": base, "args": ["sh", "-c", OUTLIVED, LIDAR], "readiness": "none"}
    options["nodes"].update(lidar=lidar, victim=victim)
    options["expect"] = {"/scan": {"rate": "0.2.."}}
    options["observability"] = {
        "enabled": True,
        "grafana": {"enabled": False},
        "ros_metrics": {
            "image": exporter,
            "topics": ["/chatter", "/scan"],
        },
    }


@pytest.fixture(scope="module")
def watched(
    cluster: Any,
    context: str,
    registry: str,
    ros2_image: str,
    exporter_image: str,
    stack: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Watched]:
    """The application, all of its nodes seen."""
    with projects(cluster, context, registry, tmp_path_factory.mktemp("ros2")) as make:
        change = partial(example, exporter=exporter_image)
        made = make("ros2-talker-listener", ros2_image, change)
        made("run", "job", "deploy")
        found = Watched(made, Watch(cluster, stack))
        until(lambda: found.values("ros_node_up", "ros_node").keys() >= NODES, "the nodes")
        yield found


def test_its_lines_are_in_loki(watched: Watched) -> None:
    """By application, ROS node and machine, at the levels of rclpy; a traceback is one entry."""
    told = {
        "info": r"\[INFO\] .* \[lidar\]: all is well",
        "warn": r"\[WARN\] .* \[lidar\]: a little late",
        "error": r"\[ERROR\] .* \[lidar\]: a ray is lost|Traceback .*\n  File .*\nIndexError: .*",
        "fatal": r"\[FATAL\] .* \[lidar\]: the laser is burnt",
    }
    machines = watched.project.machines()
    for level, form in told.items():
        chosen = f'ros_node="/lidar", level="{level}"'
        found = until(lambda chosen=chosen: watched.entries(chosen), f"lines with {chosen}")
        for labels, text in found:
            assert re.fullmatch(form, text), text
            assert labels["application"] == "rigel-k8s-application"
            assert labels["node"] == machines["lidar"]
            assert labels["workload"] == "lidar"
    chosen = 'ros_node="/listener", container="ros-node"'
    heard = until(lambda: watched.entries(chosen), "what the listener said")
    assert {labels.get("level") for labels, _ in heard} == {"info"}
    assert {labels["node"] for labels, _ in heard} == {machines["listener"]}


def test_its_graph_is_in_prometheus(watched: Watched) -> None:
    """Nodes with their workloads; publishers and subscribers, of which the exporter is none."""
    until(lambda: set(watched.values("ros_node_up", "ros_node").values()) == {1}, "all are up")
    whose = {
        one["metric"]["ros_node"]: one["metric"].get("workload")
        for one in watched.samples("ros_node_up")
    }
    assert whose == {name: name[1:].replace("_", "-") for name in NODES}

    def graph() -> dict[str, tuple[float, float]]:
        publishers, subscribers = (
            watched.values(f"ros_topic_{what}", "topic", type=STRING)
            for what in ("publishers", "subscribers")
        )
        return {topic: (count, subscribers[topic]) for topic, count in publishers.items()}

    wanted = {"/chatter": (2, 1), "/scan": (1, 0), "/beat": (1, 0), "/cmd_vel": (0, 2)}
    until(lambda: graph() == wanted, "publishers and subscribers")


def test_the_rate_of_a_named_topic_is_told_at_once(watched: Watched) -> None:
    """By the first two scrapes, not after the two minutes that a mean is taken of."""

    def right() -> bool:
        """Two talkers send ten a second, the lidar five; on a busy machine fewer for a while."""
        heard = {name: row for name, row in watched.top("--topics").items() if row["heard"]}
        rates = {name: row["rate"] or 0 for name, row in heard.items()}
        return (
            rates.keys() == {"/chatter", "/scan"}
            and 3 < rates["/chatter"] < 12
            and 1.5 < rates["/scan"] < 6
        )

    until(right, "the rates of the named topics")
    until(lambda: watched.top("--topics")["/scan"]["age"] < 5, "an age that is the message's own")
    until(
        lambda: 1.5 < (watched.top("--topics")["/beat"]["rate"] or 0) < 12,
        "the rate of a topic to which nobody subscribes, but which is sent",
    )


def test_a_deploy_alone_raises_nothing(watched: Watched) -> None:
    """But what is so: nobody publishes what the lidars hear."""
    found = watched.samples("ALERTS", alertstate="firing")
    told = {(one["metric"]["alertname"], one["metric"].get("topic")) for one in found}
    assert told <= {("RosTopicWithoutPublisher", "/cmd_vel")}


@pytest.fixture(scope="module")
def troubled(watched: Watched, cluster: Any) -> Watched:
    """A node is killed, another one's network is cut, a topic falls silent."""
    project = watched.project
    flows = "topic:ros_topic_messages:rate5m"
    until(lambda: watched.values(flows, "topic").get("/scan", 0) > 0.5, "/scan flows")
    inside(cluster, project.space, "victim", "kill -9 $(cat /tmp/pid)")
    inside(cluster, project.space, "lidar", "touch /tmp/quiet")
    project.link("talker-1", "net1", "down")
    return watched


@pytest.mark.parametrize(("panel", "target"), list(asking.questions(*BOARDS)))
def test_every_panel_answers_or_says_why(
    panel: dict[str, Any], target: dict[str, Any], troubled: Watched
) -> None:
    """Nothing is empty but what only ROS 1 has, and what nobody asked for: there it says so."""
    values = {**asking.VALUES, "namespace": troubled.project.space}
    if SAID.search(panel.get("fieldConfig", {}).get("defaults", {}).get("noValue", "")):
        assert not asking.asked(troubled.watch, target, values), "it says that there is nothing"
        return
    if any(part in target["expr"] for part in EMPTY):
        return
    what = f"an answer to {asking.filled(target['expr'], values)}"
    until(lambda: asking.asked(troubled.watch, target, values), what, 120)


def test_nodes_that_are_gone_are_told_of(troubled: Watched) -> None:
    """Killed in a pod that is Ready, or cut off in one whose container runs; no other."""
    gone = {"/victim", "/talker_1"}
    until(lambda: {one["ros_node"] for one in troubled.alerts("RosNodeGone")} == gone, "both")
    ready = {
        pod.rpartition("-")[0].rpartition("-")[0]: value
        for pod, value in troubled.values("kube_pod_status_ready", "pod", condition="true").items()
    }
    assert ready["victim"] == 1
    for alert in troubled.alerts("RosNodeGone"):
        assert alert["application"] == "rigel-k8s-application"
        assert alert["workload"] == alert["ros_node"][1:].replace("_", "-")
        assert alert["severity"] == "critical"
    assert troubled.top()["/victim"]["up"] is False


def test_a_silent_topic_is_told_of(troubled: Watched) -> None:
    """Its publisher is up and says nothing; one of whose two publishers is gone still flows."""
    (alert,) = until(lambda: troubled.alerts("RosTopicSilent"), "RosTopicSilent")
    assert (alert["topic"], alert["severity"]) == ("/scan", "warning")
    assert alert["application"] == "rigel-k8s-application"
    assert troubled.values("ros_node_up", "ros_node")["/lidar"] == 1

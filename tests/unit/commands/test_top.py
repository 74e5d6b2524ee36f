"""What Prometheus and a kubelet answer as rows; the answers have the form of real ones."""

from __future__ import annotations

import json
from collections.abc import Mapping

import pytest

from rigel_k8s.cli.top import cells, rate, show, size_of, topic_cells
from rigel_k8s.commands import top
from rigel_k8s.commands.pods import Pod
from rigel_k8s.commands.targets import Release
from rigel_k8s.commands.top import (
    TOPICS,
    Top,
    Usage,
    UsageRow,
    make_rows,
    read_summary,
    topics_of,
)
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import ObjectRef
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.observability.reading.prometheus import PrometheusClient, Sample, matchers
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, desired, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy

SUMMARY = {
    "pods": [
        {
            "podRef": {"name": "talker-1", "namespace": "lab", "uid": "00703f91"},
            "containers": [
                {
                    "name": "ros-node",
                    "cpu": {"usageNanoCores": 6264841, "usageCoreNanoSeconds": 7948880766},
                    "memory": {"usageBytes": 24821760, "workingSetBytes": 24662016},
                }
            ],
        },
        {"podRef": {"name": "new-1", "namespace": "lab"}, "containers": [{"name": "c", "cpu": {}}]},
        {"podRef": {"name": "talker-1", "namespace": "other"}, "containers": []},
    ]
}


def test_a_kubelets_summary_tells_of_a_namespace() -> None:
    """What has just begun has no rate yet, and is left out rather than told as nothing."""
    used = Usage(0.006264841, 24662016.0)
    assert read_summary(SUMMARY, "lab") == {("talker-1", "ros-node"): used, ("talker-1", ""): used}


def test_a_query_leaves_out_what_is_no_number() -> None:
    """Prometheus writes values as text, NaN among them."""
    metrics = [({"topic": "/scan"}, "0.5"), ({"topic": "/none"}, "NaN")]
    result = [{"metric": labels, "value": [1795266257.7, value]} for labels, value in metrics]
    body = {"status": "success", "data": {"resultType": "vector", "result": result}}

    def ask(path: str, query: Mapping[str, object]) -> bytes:
        assert (path, query) == ("api/v1/query", {"query": "x"})
        return json.dumps(body).encode()

    assert PrometheusClient(ask).query("x") == [Sample({"topic": "/scan"}, 0.5)]
    assert matchers(application='a"b') == 'application="a\\"b"'


def test_usage_comes_from_the_kubelets_without_a_metrics_server(
    fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And without a stack nothing is known of ROS; a cluster without both says why."""
    deploy(desired(workload()), fake, report=report)
    (name,) = (item["metadata"]["name"] for item in fake.list("v1", "Pod", "n"))
    ref = {"podRef": {"name": name, "namespace": "n"}}
    asked: list[str] = []

    def ask(self: FakeCluster, node: ObjectRef, path: str, **_: object) -> str:
        asked.append(f"{node.name} {path}")
        return json.dumps({"pods": [{**SUMMARY["pods"][0], **ref}]})

    monkeypatch.setattr(FakeCluster, "get_through_proxy", ask, raising=False)
    monkeypatch.setattr(top, "release", lambda *_: Release(fake, RELEASE))  # type: ignore[arg-type]
    found = top.top(Settings(), [])
    assert (found.source, [row.pod for row in found.rows]) == ("kubelet", [name])
    assert (found.rows[0].cpu, found.rows[0].up) == (0.006264841, None)
    assert asked == ["node1 stats/summary"]

    def refuse(*_: object, **__: object) -> None:
        raise Forbidden("no")

    monkeypatch.setattr(FakeCluster, "get_through_proxy", refuse)
    with pytest.raises(ClusterError, match="no source has the usage") as caught:
        top.top(Settings(), [])
    assert any("no metrics-server" in line for line in caught.value.details)
    assert "you may not ask the kubelets" in caught.value.details


def pod(workload: str, ros_name: str) -> Pod:
    return Pod(
        name=f"{workload}-1",
        namespace="lab",
        workload=workload,
        aliases=frozenset(),
        container="c",
        scripts=True,
        phase="Running",
        created="",
        ready=True,
        ros_name=ros_name,
        machine="node2",
        restarts=3,
    )


def node(name: str, value: float) -> list[Sample]:
    return [Sample({"ros_node": name}, value)]


def make_row(of: Pod, usage: Usage | None, samples: Mapping[str, list[Sample]]) -> UsageRow:
    (row,) = make_rows([of], {(of.name, ""): usage} if usage else {}, samples)
    return row


def test_a_row_says_nothing_that_nobody_told() -> None:
    """And what was told in units that people read."""
    told = {
        "up": node("/talker", 1.0),
        "all_up": [Sample({"workload": "launch"}, 0.0)],
        "published": node("/talker", 10.04),
        "received": node("/talker", 0.0),
    }
    row = make_row(pod("talker", "/talker"), Usage(0.00626, 24662016.0), told)
    assert cells(row) == [
        *("talker", "/talker", "yes", "6m", "24Mi", "10.0", "0", "3", "talker-1", "node2")
    ]
    assert cells(make_row(pod("launch", ""), None, told))[1:8] == ["-", "NO", *"----", "3"]
    assert make_row(pod("other", "/other"), None, {}).up is None


@pytest.mark.parametrize(
    ("names", "heads"),
    [
        (("up", "published", "received"), "UP CPU MEMORY OUT IN"),
        (("up", "published"), "UP CPU MEMORY OUT IN"),
        (("up",), "UP CPU MEMORY"),
        ((), "CPU MEMORY"),
    ],
)
def test_columns_that_nobody_tells_are_left_out(
    names: tuple[str, ...], heads: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """ROS 2's nodes count no messages, and without an exporter nobody knows who is up."""
    row = make_row(pod("talker", "/talker"), None, {name: node("/talker", 1.0) for name in names})
    show(Top(ReleaseId("lab", "demo"), (row,), "kubelet"), "table")
    shown = capsys.readouterr().out.splitlines()[0].split()
    assert shown == ["NODE", "ROS", "NAME", *heads.split(), "RESTARTS", "POD", "ON"]


def topic(name: str, value: float, **more: str) -> Sample:
    return Sample({"topic": name, **more}, value)


def test_topics_that_are_heard_tell_more() -> None:
    """Of the others the nodes' own counts are told, and no age."""
    string = "std_msgs/String"
    answers: dict[str, list[Sample]] = {key: [] for key in TOPICS}
    answers |= {
        "publishers": [topic("/chatter", 1, type=string), topic("/rosout", 3, type="Log")],
        "subscribers": [topic("/chatter", 2, type=string), topic("/lost", 1, type=string)],
        "heard": [topic("/chatter", 5.0)],
        "heard_bytes": [topic("/chatter", 2048.0)],
        "counted": [topic("/chatter", 99.0), topic("/rosout", 120.4)],
        "age": [topic("/chatter", 0.21)],
        "delay": [topic("/chatter", 0.0012)],
    }
    chatter, lost, rosout = (topic_cells(row) for row in topics_of(answers))
    assert chatter == [
        *("/chatter", string, "1", "2", "5.0/s", "2.0Ki/s", "0.2s ago", "1.2ms")
    ]  # fmt: skip
    assert lost == ["/lost", string, "0", "1", "-", "-", "-", "-"]
    assert rosout[2:] == ["3", "0", "120/s", "-", "-", "-"]


def test_small_and_large_numbers_stay_short() -> None:
    """Three digits say enough."""
    assert [rate(value) for value in (0, 0.0333, 9.83, 120.4)] == ["0", "0.033", "9.8", "120"]
    assert [size_of(v) for v in (12, 2048, 3 << 20, 5 << 30)] == ["12B", "2.0Ki", "3.0Mi", "5.0Gi"]


def test_without_a_stack_another_command_shows_topics(
    fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At once; the stack is named as well."""
    deploy(desired(workload()), fake, report=report)
    monkeypatch.setattr(top, "release", lambda *_: Release(fake, RELEASE))  # type: ignore[arg-type]
    with pytest.raises(UserError) as caught:
        top.topics(Settings(), ())
    assert "`rigel graph` shows topics and rates" in str(caught.value.hint)
    assert "observability" in str(caught.value.hint)

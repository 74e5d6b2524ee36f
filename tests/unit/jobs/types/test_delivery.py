"""The delivery check: which messages count, which pods are meant, what is told when they fail."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.types import delivery
from rigel_k8s.jobs.types.delivery import Arrivals, DeliveryJob, DeliveryOptions, ros_of
from rigel_k8s.objects.scalars import Duration, ObjectName
from rigel_k8s.rigelfile import InvalidOptions, structure_plain
from rigel_k8s.settings import Application, Settings
from tests.support.recorder import Recorder


def lines(*numbers: int, nonce: str = "n1") -> list[str]:
    return [f"[INFO] [{n}.5]: I heard hello world {nonce} {n}" for n in numbers]


def test_consecutive_numbers_of_the_nonce_are_counted() -> None:
    """Each message counts once, whatever else the lines hold."""
    arrivals = Arrivals("n1")
    assert list(arrivals.count(lines(7, 8, 9))) == [1, 2, 3]
    assert arrivals.numbers == [7, 8, 9]
    assert arrivals.gap is None


def test_other_lines_and_older_nonces_do_not_count() -> None:
    """A message made before the check started proves nothing."""
    arrivals = Arrivals("n1")
    told = [*lines(5, nonce="none"), *lines(6, nonce="n12"), "n1", *lines(7)]
    assert list(arrivals.count(told)) == [1]


def test_a_line_that_the_log_tells_twice_is_one_message() -> None:
    """Following a log again after a break repeats lines."""
    assert list(Arrivals("n1").count(lines(1, 2, 2, 3))) == [1, 2, 3]


@pytest.mark.parametrize(("numbers", "gap"), [((1, 2, 4), "2 came 4"), ((5, 6, 1), "6 came 1")])
def test_a_missing_message_is_a_gap(numbers: tuple[int, ...], gap: str) -> None:
    """A lost message, or a publisher that began anew, ends the counting."""
    arrivals = Arrivals("n1")
    list(arrivals.count(lines(*numbers, 7)))
    assert arrivals.gap
    assert gap in arrivals.gap


def test_at_least_one_message_must_be_asked_for() -> None:
    """`messages: 0` would be a check that cannot fail."""
    asked = {"publisher": "talker", "subscriber": "listener", "messages": 0}
    with pytest.raises(InvalidOptions, match="at least 1"):
        structure_plain(asked, DeliveryOptions, lambda _: ())


def test_a_node_that_hears_itself_is_refused() -> None:
    """It would prove nothing about the way between two pods."""
    options = DeliveryOptions(publisher="talker", subscriber="talker")
    (problem,) = DeliveryJob().check(options, Application("noetic"))
    assert (problem.path, problem.kind) == (("subscriber",), "same-node")


def pod(name: str, machine: str, *, ready: bool = True, **meta: Any) -> dict[str, Any]:
    label = {"app.kubernetes.io/name": name.rsplit(".", 1)[0], "rigel-k8s/release": "demo"}
    return {
        "metadata": {"name": name, "labels": label, **meta},
        "spec": {"nodeName": machine, "containers": [{"name": "ros-node"}]},
        "status": {"conditions": [{"type": "Ready", "status": str(ready)}]},
    }


@attrs.define
class FakeCluster:
    """The boundary to Kubernetes: pods, and a log that speaks of the nonce that was set."""

    pods: list[dict[str, Any]]
    numbers: tuple[int, ...] = tuple(range(1, 30))
    codes: tuple[int, ...] = (0, 0)
    namespace: str = "of-context"
    asked: list[Any] = attrs.field(factory=list)
    nonce: str = ""
    endures: bool = False

    def __enter__(self) -> FakeCluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.asked.append("closed")

    def endure(self, *_: object) -> None:
        self.endures = True

    def list(self, version: str, kind: str, namespace: str, *, labels: Any) -> list[dict[str, Any]]:
        self.asked.append((namespace, labels))
        return self.pods

    def run(self, namespace: str, pod: str, command: list[str], *, container: str) -> Any:
        self.asked.append(command)
        self.nonce = command[-1]
        code, *self.codes = self.codes

        @attrs.frozen
        class Result:
            code: int
            stdout: bytes = b""
            stderr: bytes = b"Connection refused\n"

        return Result(code)

    def logs(
        self,
        namespace: str,
        pod: str,
        container: str,
        *,
        follow: bool,
        since_seconds: int,
        cancel: threading.Event,
    ) -> Iterator[str]:
        yield from lines(*self.numbers, nonce=self.nonce)
        if not cancel.wait(20):
            raise AssertionError("the log was followed for ever")


TWO = [pod("talker", "node1"), pod("listener", "node2")]


def check(
    monkeypatch: pytest.MonkeyPatch,
    cluster: FakeCluster,
    settings: Settings | None = None,
    **more: Any,
) -> tuple[Recorder, JobContext]:
    monkeypatch.setattr(delivery, "connect", lambda settings: cluster)
    monkeypatch.setattr(delivery, "LOOK", 0.01)
    options: dict[str, Any] = {
        "publisher": "talker",
        "subscriber": "listener",
        "timeout": Duration("0.05"),
        "deployment_name": ObjectName("demo"),
        **more,
    }
    report = Recorder()
    job = JobContext("check", Application("noetic"), report, settings or Settings())
    DeliveryJob().run(DeliveryOptions(**options), job)
    return report, job


def test_messages_that_arrive_are_told_with_both_machines(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was proven stands in one line, and the connection is closed."""
    cluster = FakeCluster(TWO)
    report, _ = check(monkeypatch, cluster)
    assert report.lines == ["10 messages, 1 to 10, arrived from talker (node1) at listener (node2)"]
    assert cluster.asked[-1] == "closed"
    assert cluster.endures, "an API server that is away for a moment does not fail the check"
    assert cluster.nonce.startswith("n")


def test_two_checks_use_two_nonces(monkeypatch: pytest.MonkeyPatch) -> None:
    """An old message cannot satisfy a new check."""
    first, second = FakeCluster(TWO), FakeCluster(TWO)
    check(monkeypatch, first)
    check(monkeypatch, second)
    assert first.nonce != second.nonce


@pytest.mark.parametrize(
    ("settings", "more", "namespace"),
    [
        (Settings(namespace="of-flag"), {"namespace": ObjectName("of-file")}, "of-flag"),
        (Settings(), {"namespace": ObjectName("of-file")}, "of-file"),
        (Settings(), {}, "of-context"),
    ],
)
def test_the_namespace_is_the_flags_then_the_files_then_the_contexts(
    monkeypatch: pytest.MonkeyPatch, settings: Settings, more: dict[str, Any], namespace: str
) -> None:
    """The same order as the deploy job has."""
    cluster = FakeCluster(TWO)
    check(monkeypatch, cluster, settings, **more)
    assert cluster.asked[0] == (namespace, {"rigel-k8s/release": "demo"})


@pytest.mark.parametrize(
    ("cluster", "more", "message", "detail"),
    [
        (
            FakeCluster([pod("talker", "node1"), pod("listener", "node1")]),
            {},
            "one machine, node1",
            "",
        ),
        (FakeCluster(TWO, numbers=(1, 2)), {}, "2 of 10 messages", "I heard hello world"),
        (FakeCluster(TWO, numbers=()), {}, "0 of 10 messages", "nothing"),
        (FakeCluster(TWO, numbers=(1, 3)), {}, "after message 1 came 3", "pod listener on node2"),
        (
            FakeCluster(TWO, codes=(1,)),
            {},
            "cannot set the ROS parameter /nonce",
            "Connection refused",
        ),
        (FakeCluster(TWO), {"publisher": "tlker"}, "tlker has no pod", "listener, talker"),
        (
            FakeCluster([pod("talker", "node1", ready=False), TWO[1]]),
            {},
            "talker has no ready pod",
            "pod talker on node1, not ready",
        ),
        (
            FakeCluster([pod("talker", "node1", deletionTimestamp="now"), TWO[1]]),
            {},
            "talker has no ready pod",
            "not ready",
        ),
    ],
)
def test_what_is_wrong_is_told(
    monkeypatch: pytest.MonkeyPatch,
    cluster: FakeCluster,
    more: dict[str, Any],
    message: str,
    detail: str,
) -> None:
    """Which pods, which machines, what arrived instead, what next."""
    with pytest.raises(RigelK8sError) as caught:
        check(monkeypatch, cluster, **more)
    assert message in caught.value.message
    assert detail in "\n".join(caught.value.details)
    assert caught.value.hint


def test_pods_on_one_machine_do_where_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """across_machines: false, for a cluster of one machine."""
    cluster = FakeCluster([pod("talker", "node1"), pod("listener", "node1")])
    report, _ = check(monkeypatch, cluster, across_machines=False)
    assert "arrived" in report.lines[0]


def test_python_2_images_are_asked_with_python(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no python3, python is tried."""
    cluster = FakeCluster(TWO, codes=(127, 0))
    check(monkeypatch, cluster)
    assert [c[2] for c in cluster.asked if isinstance(c, list)] == ["python3", "python"]


ROS2 = {"rigel-k8s/ros-name": "/front/talker", "rigel-k8s/network": '{"ros": "2"}'}


def test_a_parameter_of_ros_2_is_set_at_the_publishers_own_node(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The pod says that it is ROS 2, whatever the Rigelfile's distro is."""
    cluster = FakeCluster([pod("talker", "node1", annotations=ROS2), TWO[1]])
    check(monkeypatch, cluster)
    (command,) = [c for c in cluster.asked if isinstance(c, list)]
    assert command[2] == "python3"
    assert "import rclpy" in command[4]
    assert command[5:] == ["/front/talker", "nonce", cluster.nonce]


def test_a_node_of_ros_2_that_refuses_is_told_with_what_it_needs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """rclpy's absence ends the check: there is no other Python to try."""
    cluster = FakeCluster([pod("talker", "node1", annotations=ROS2), TWO[1]], codes=(127,))
    with pytest.raises(RigelK8sError) as caught:
        check(monkeypatch, cluster)
    assert "rclpy" in str(caught.value.hint)


@pytest.mark.parametrize(("distro", "ros"), [("noetic", "1"), ("jazzy", "2")])
def test_a_pod_that_does_not_say_speaks_the_applications_ros(distro: str, ros: str) -> None:
    """Pods of a release from before the annotation."""
    assert ros_of(pod("talker", "node1"), distro) == ros


def test_a_ros_name_and_a_namespaced_key_find_their_pod(monkeypatch: pytest.MonkeyPatch) -> None:
    """`/front/talker`, `front/talker` and the Deployment's name mean one node."""
    named = pod("front-talker", "node1", annotations={"rigel-k8s/ros-name": "/front/talker"})
    for key in ("/front/talker", "front/talker", "front-talker"):
        report, _ = check(monkeypatch, FakeCluster([named, TWO[1]]), publisher=key)
        assert "arrived" in report.lines[0]


def test_the_newest_ready_pod_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """During an update the old pod may still be there."""
    old = pod("talker", "node9", creationTimestamp="2026-01-01T00:00:00Z")
    new = pod("talker", "node3", creationTimestamp="2026-01-02T00:00:00Z")
    report, _ = check(monkeypatch, FakeCluster([new, old, TWO[1]]))
    assert "talker (node3)" in report.lines[0]


def test_a_check_that_is_stopped_is_interrupted_and_not_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ctrl-C while it waits says nothing about the messages."""
    cluster = FakeCluster(TWO, numbers=())
    monkeypatch.setattr(delivery, "connect", lambda settings: cluster)
    job = JobContext("check", Application("noetic"), Recorder())
    job.cancel.set()
    options = DeliveryOptions(publisher="talker", subscriber="listener")
    with pytest.raises(Interrupted):
        DeliveryJob().run(options, job)

"""The stack on a real cluster: what ROS nodes print is found, nothing of it lost or double."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import DeployOptions
from tests.support import until as waiting
from tests.support.recorder import Recorder

from ..conftest import run_rigel
from .conftest import PATIENCE, Stack, until

pytestmark = pytest.mark.cluster

#: What a ROS 1 node logs by rospy, what C++ and ROS 2 nodes print, and a number for ever.
PROGRAM = r"""
import itertools, sys, time, traceback
import rospy
rospy.init_node('talker')
rospy.loginfo('all is well'); rospy.logwarn('slow'); rospy.logerr('blocked'); rospy.logfatal('lost')
def fail(): return {}['battery']
try: fail()
except KeyError: rospy.logerr(traceback.format_exc())
print('\x1b[33m[ WARN] [1700000000.5]: from rosconsole\x1b[0m')
print('[ INFO] [1700000000.6]: from rosconsole')
print('[DEBUG] [1700000000.123456789] [planner]: from ROS 2')
print('[planner-1] [FATAL] [1700000000.123456789] [planner]: launched')
print('no level at all', flush=True)
try: fail()
except KeyError: traceback.print_exc()
print('[INFO] [1700000000.2] [planner]: after it', file=sys.stderr, flush=True)
for number in itertools.count():
    print('count %d' % number, flush=True)
    time.sleep(0.05)
"""
LABELS = {"application", "workload", "ros_node", "namespace", "pod", "container", "node", "level"}


@attrs.frozen
class Talker:
    """A node whose lines are looked for."""

    namespace: str
    stack: Stack

    @property
    def selector(self) -> str:
        """Its streams."""
        return f'{{namespace="{self.namespace}", ros_node="/talker"}}'

    def streams(self, more: str = "") -> list[dict[str, Any]]:
        """Return its streams."""
        return self.stack.loki(self.selector + more)

    def entry(self, text: str) -> tuple[str, dict[str, str]]:
        """Return the one entry with a text, and its labels."""

        def look() -> list[tuple[str, dict[str, str]]]:
            return [
                (line, one["stream"])
                for one in self.streams(f" |= `{text}`")
                for _, line in one["values"]
            ]

        found = until(look, f"a line with {text}")
        assert len(found) == 1, found
        return found[0]

    def numbers(self) -> list[int]:
        """Return the numbers that are stored, in the order of their time."""
        lines = self.stack.lines(self.selector + " |= `count `")
        return [int(line.split()[-1]) for _, line in lines]

    def beyond(self, number: int) -> int:
        """Return the last number as soon as it is beyond another."""
        return until(lambda: self._last_beyond(number), f"a number beyond {number}")

    def _last_beyond(self, number: int) -> int:
        last = (self.numbers() or [0])[-1]
        return last if last > number else 0

    def check_whole_beyond(self, number: int) -> None:
        """Wait until a number beyond another is there, and each before it once.

        What waits to be sent again may arrive after what is newer.
        """

        def is_whole() -> bool:
            numbers = self.numbers()
            return bool(numbers) and numbers == list(range(max(number, numbers[-1]) + 1))

        def describe() -> str:
            numbers = self.numbers()
            missing = sorted(set(range(max([number, *numbers]) + 1)) - set(numbers))
            double = sorted({one for one in numbers if numbers.count(one) > 1})
            return f"missing {missing[:50]}, double {double[:50]}, last {numbers[-1:]}"

        waiting.until(
            is_whole,
            f"each number up to one beyond {number}, once",
            PATIENCE,
            every=0.5,
            despite=(ClusterError,),
            last_words=describe,
        )


@pytest.fixture(scope="module")
def talker(
    watching: Stack, context: str, base_image: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Talker]:
    """A ROS 1 node that logs."""
    namespace = f"t-stack-{uuid.uuid4().hex[:6]}"
    file = tmp_path_factory.mktemp("talker") / "Rigelfile"
    yield start_talker(watching, context, base_image, namespace, file)
    watching.cluster.delete(ObjectRef("v1", "Namespace", "", namespace))


def start_talker(stack: Stack, context: str, base_image: str, namespace: str, file: Path) -> Talker:
    """Deploy a ROS 1 node that logs."""
    job = {
        "namespace": namespace,
        "deployment_name": "demo",
        "ros_master_image": base_image,
        "image": base_image,
        "nodes": {"talker": {"args": ["python3", "-u", "-c", PROGRAM]}},
    }
    jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
    file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
    run_rigel("--context", context, "-f", str(file), "run", "job", "deploy")
    return Talker(namespace, stack)


#: A text of each line, and the level that it says.
LEVELS = {
    "all is well": "info",
    "slow": "warn",
    "blocked": "error",
    ": lost": "fatal",
    "WARN] [1700000000.5]": "warn",
    "INFO] [1700000000.6]": "info",
    "from ROS 2": "debug",
    "launched": "fatal",
    "after it": "info",
}


@pytest.mark.parametrize(("text", "level"), LEVELS.items())
def test_a_line_has_the_level_that_it_says(talker: Talker, text: str, level: str) -> None:
    """ROS 1's, by rospy and by rosconsole with its colours, ROS 2's, and what a launch prints."""
    _, labels = talker.entry(text)
    assert labels["level"] == level


def test_a_line_has_the_labels_of_the_contract_and_no_other(talker: Talker) -> None:
    """They are those of metrics too, so that one leads to the other."""
    line, labels = talker.entry("no level at all")
    (pod,) = [
        pod
        for pod in talker.stack.cluster.list("v1", "Pod", talker.namespace)
        if pod["metadata"]["labels"]["app.kubernetes.io/name"] == "talker"
    ]
    assert line == "no level at all"
    assert labels == {
        "application": "demo",
        "workload": "talker",
        "ros_node": "/talker",
        "namespace": talker.namespace,
        "pod": pod["metadata"]["name"],
        "container": "ros-node",
        "node": pod["spec"]["nodeName"],
    }
    for one in talker.stack.loki('{application!=""}'):
        assert set(one["stream"]) <= LABELS


def test_a_traceback_is_one_entry(talker: Talker) -> None:
    """Logged by rospy, and printed by Python where nobody caught it."""
    check_tracebacks(talker)


def check_tracebacks(talker: Talker) -> None:
    """Both are there, whole, and neither is in two entries."""

    def look() -> list[dict[str, Any]] | None:
        found = talker.streams(' |= "Traceback (most recent call last)"')
        return found if sum(len(one["values"]) for one in found) >= 2 else None

    streams = until(look, "both tracebacks")
    entries = sorted(line for one in streams for _, line in one["values"])
    assert len(entries) == 2, entries
    assert {one["stream"]["level"] for one in streams} == {"error"}
    for entry in entries:
        lines = entry.rstrip("\n").splitlines()
        assert "Traceback" in lines[0]
        assert lines[-1] == "KeyError: 'battery'", entry
        assert len(lines) >= 4, entry
    assert entries[1].startswith("[ERROR]") is not entries[0].startswith("[ERROR]")


def test_every_job_has_all_its_targets_up(watching: Stack, cluster: Any) -> None:
    """One for each machine where a program is on each."""
    nodes = len(cluster.nodes())
    wanted = dict.fromkeys(("prometheus", "loki", "kube-state-metrics"), 1)
    wanted |= dict.fromkeys(("otel-collector", "node-exporter", "cadvisor", "kubelet"), nodes)

    def up() -> bool:
        # Not by `up`: after a restart it has targets of before for some minutes.
        active = watching.ask("prometheus", 9090, "api/v1/targets")["activeTargets"]
        health = [(one["labels"]["job"], one["health"]) for one in active]
        return all(health.count((job, "up")) == count for job, count in wanted.items())

    until(up, f"up: {wanted}")


def test_cadvisor_and_kubernetes_know_the_ros_node(talker: Talker) -> None:
    """CPU, memory and restarts come by pod; kube-state-metrics tells which ROS node that is."""
    pod = f'namespace="{talker.namespace}", pod=~"talker-.*"'

    def known() -> bool:
        metrics = talker.stack.metrics
        return bool(
            metrics(f'container_memory_working_set_bytes{{{pod}, container="ros-node"}}')
            and metrics(f'kube_pod_annotations{{{pod}, annotation_rigel_k8s_ros_name="/talker"}}')
            and metrics(f'kube_pod_labels{{{pod}, label_rigel_k8s_release="demo"}}')
        )

    until(known, "the talker's memory and who it is")


def test_a_new_collector_leaves_no_gap_and_no_double(talker: Talker) -> None:
    """It goes on where the one before it stopped."""
    check_restart(talker, "otel-collector")


def check_restart(talker: Talker, collector: str) -> None:
    """Every number is there once, those of the restart too."""
    last = talker.beyond(50)
    talker.stack.restart(collector)
    talker.check_whole_beyond(last + 100)


def test_promtail_reads_the_same(
    watching: Stack,
    more_images: None,
    context: str,
    base_image: str,
    namespace: str,
    tmp_path: Path,
) -> None:
    """`collector: promtail` replaces the collector; levels, labels and tracebacks stay."""
    watching.deploy({"collector": "promtail"})
    try:
        until(lambda: not watching.pods("otel-collector"), "the other collector has ended")
        file = tmp_path / "Rigelfile"
        talker = start_talker(watching, context, base_image, namespace, file)
        for text, level in LEVELS.items():
            labels = talker.entry(text)[1]
            assert (labels["level"], set(labels) <= LABELS) == (level, True)
        check_tracebacks(talker)
        check_restart(talker, "promtail")
    finally:
        watching.deploy({"collector": "otel-collector"})
    until(lambda: not watching.pods("promtail"), "Promtail has ended")


def test_a_collector_that_ends_while_loki_is_away_loses_nothing(talker: Talker) -> None:
    """What it had read, and could not deliver, is delivered by the next one."""
    last, stack = talker.beyond(50), talker.stack
    old = {pod["metadata"]["uid"] for pod in stack.pods("loki")}
    stack.end("loki")
    time.sleep(2)  # lines that are read meanwhile wait
    stack.restart("otel-collector")
    until(lambda: stack.has_anew("loki", old) and answers(talker), "Loki answers")
    talker.check_whole_beyond(last + 200)


def answers(talker: Talker) -> bool:
    """Whether Loki answers again."""
    try:
        return bool(talker.streams())
    except ClusterError:
        return False


def test_data_outlive_the_stack(talker: Talker) -> None:
    """`down` leaves the claims, and the stack that comes next has all that was stored."""
    from rigel_stack.removal import remove

    stack = talker.stack
    last = talker.beyond(50)
    remove(stack.cluster, DeployOptions(report=Recorder()), volumes=False)
    claims = stack.cluster.list("v1", "PersistentVolumeClaim", stack.namespace)
    assert {c["metadata"]["name"] for c in claims} >= {"loki-data", "prometheus-data"}
    assert stack.cluster.list("apps/v1", "Deployment", stack.namespace) == []
    stack.deploy()
    until(lambda: answers(talker), "Loki answers")
    talker.check_whole_beyond(last + 100)


ALLOWED = [
    ("otel-collector", "list", "", "pods", ""),
    ("otel-collector", "watch", "", "pods", ""),
    ("prometheus", "list", "", "pods", ""),
    ("prometheus", "list", "", "nodes", ""),
    ("prometheus", "get", "", "nodes", "metrics"),
    ("kube-state-metrics", "list", "apps", "deployments", ""),
]
PARTS = ("loki", "otel-collector", "prometheus", "kube-state-metrics", "node-exporter")
DANGEROUS = [
    ("get", "", "secrets", ""),
    ("list", "", "configmaps", ""),
    ("get", "", "nodes", "proxy"),
    ("create", "", "pods", "exec"),
    ("get", "", "pods", "log"),
    ("delete", "", "pods", ""),
    ("patch", "apps", "deployments", ""),
]


@pytest.mark.parametrize("part", PARTS)
def test_a_part_may_do_what_it_must_and_nothing_else(watching: Stack, part: str) -> None:
    """No Secret, no other's process, no kubelet's proxy."""
    assert [one for one in ALLOWED if one[0] == part and not may(watching, *one)] == []
    assert [one for one in DANGEROUS if may(watching, part, *one)] == []


def may(stack: Stack, part: str, verb: str, group: str, resource: str, below: str) -> bool:
    """Ask the API server what an account may do."""
    user = f"system:serviceaccount:{stack.namespace}:{part}"
    groups = ["system:serviceaccounts", "system:authenticated"]
    attributes = {"verb": verb, "group": group, "resource": resource, "subresource": below}
    answer = stack.cluster.client.call(
        "POST",
        "/apis/authorization.k8s.io/v1/subjectaccessreviews",
        "ask what an account may do",
        read_mapping,
        body={
            "apiVersion": "authorization.k8s.io/v1",
            "kind": "SubjectAccessReview",
            "spec": {"user": user, "groups": groups, "resourceAttributes": attributes},
        },
    )
    return bool(answer["status"]["allowed"])


#: What cannot be run where its images cannot be had.
UNRUN = {
    "grafana": {"grafana": {"service_type": "NodePort", "persistence": {"enabled": True}}},
    "their loki": {
        "collector": "promtail",
        "existing": {"loki": {"url": "http://loki.logging:3100", "tenant": "a", "secret": "b"}},
    },
}


@pytest.mark.parametrize("what", UNRUN)
def test_what_is_not_run_here_is_taken_by_the_api_server(
    cluster: Any, namespace: str, what: str
) -> None:
    """Every field of every object is known, and nothing is refused or dropped in silence."""
    from rigel_k8s.observability.options import request_of
    from rigel_stack.install import render_stack

    for item in render_stack(request_of(UNRUN[what]), namespace).desired.objects:
        made = cluster.apply(item, dry_run=True, force=True)
        assert made["metadata"]["name"] == item["metadata"]["name"]

"""The stack on a real cluster: what ROS nodes print is found, nothing of it lost or double."""

from __future__ import annotations

import json
import re
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


def test_a_second_deploy_writes_nothing(watching: Stack) -> None:
    """Nor does one that says less: what it does not say stays."""
    watching.deploy()
    before = versions(watching)
    assert "is unchanged" in watching.deploy()
    assert "is unchanged" in watching.deploy({"node_exporter": True})
    assert versions(watching) == before


def versions(stack: Stack) -> dict[str, str]:
    """Return what changes when the release does."""
    kinds = (("apps/v1", "Deployment"), ("apps/v1", "DaemonSet"), ("v1", "Secret"))
    return {
        f"{kind}/{one['metadata']['name']}": str(
            one["metadata"]["resourceVersion"]
            if kind == "Secret"
            else one["metadata"]["generation"]
        )
        for version, kind in kinds
        for one in stack.cluster.list(version, kind, stack.namespace)
    }


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


def test_loki_keeps_its_lines_over_a_restart(talker: Talker) -> None:
    """Those that it has, and those that come while it is away."""
    last = talker.beyond(50)
    talker.stack.restart("loki")
    until(lambda: answers(talker), "Loki answers")
    talker.check_whole_beyond(last + 100)


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


def test_prometheus_keeps_its_samples_over_a_restart(watching: Stack) -> None:
    """What it had scraped before is there after."""
    query = 'max_over_time(timestamp(up{job="kubelet"})[1h:15s])'
    nodes = len(watching.cluster.nodes())
    until(lambda: len(watching.metrics('up{job="kubelet"}')) >= nodes, "a scrape of each kubelet")
    before = time.time()
    watching.restart("prometheus")
    until(lambda: watching.metrics(f"{query} > {before}"), "scrapes after the restart")
    oldest = watching.metrics('min_over_time(timestamp(up{job="kubelet"})[1h:5s])')
    assert all(float(sample["value"][1]) < before for sample in oldest)


def test_data_outlive_the_stack(talker: Talker) -> None:
    """`down` leaves the claims, and the stack that comes next has all that was stored."""
    from rigel_k8s.observability.removal import remove

    stack = talker.stack
    last = talker.beyond(50)
    remove(stack.cluster, DeployOptions(report=Recorder()), volumes=False)
    claims = stack.cluster.list("v1", "PersistentVolumeClaim", stack.namespace)
    assert {c["metadata"]["name"] for c in claims} >= {"loki-data", "prometheus-data"}
    assert stack.cluster.list("apps/v1", "Deployment", stack.namespace) == []
    stack.deploy()
    until(lambda: answers(talker), "Loki answers")
    talker.check_whole_beyond(last + 100)


def test_applications_share_one_stack(
    watching: Stack, context: str, tmp_path: Path, namespace: str, base_image: str
) -> None:
    """One that only says `enabled: true` takes nothing back, and tells nothing of it."""
    resources = {"requests": {"cpu": "11m"}}
    watching.deploy({"kube_state_metrics": {"resources": resources}})
    job = {
        "namespace": namespace,
        "ros_master_image": base_image,
        "deploy_ros_master": True,
        "observability": {"enabled": True, "ros_metrics": False},
    }
    jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
    file = tmp_path / "Rigelfile"
    file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
    before = versions(watching)
    done = run_rigel("--context", context, "-f", str(file), "run", "job", "deploy")
    assert "rigel-observability" not in done.stdout + done.stderr
    assert versions(watching) == before
    job["observability"] = {"enabled": True, "namespace": "elsewhere"}
    file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
    done = run_rigel("--context", context, "-f", str(file), "run", "job", "deploy", check=False)
    assert done.returncode == 2
    assert re.search(r"has an observability stack in the namespace monitoring", done.stderr)


def test_a_grafana_that_cannot_be_pulled_keeps_nothing_waiting(watching: Stack) -> None:
    """The stack is good without it, and says the way out; its password is there, made once."""
    secret = ObjectRef("v1", "Secret", watching.namespace, "grafana-admin")
    grafana = {"enabled": True, "image": "127.0.0.1:1/grafana:none"}
    told = watching.deploy({"grafana": grafana})
    assert "grafana is not ready" in told
    assert "grafana.image" in told
    assert "is at revision" in told
    made = watching.cluster.get(secret)
    assert len(made["data"]["admin-password"]) >= 24
    assert "is unchanged" in watching.deploy({"grafana": grafana})
    watching.deploy({"grafana": {"enabled": False}})
    until(lambda: not watching.pods("grafana"), "its pod is gone")
    assert watching.cluster.get(secret)["data"] == made["data"]


#: (account, verb, group, resource, subresource) that a part may do, in all namespaces.
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


@pytest.mark.parametrize(("part", "verb", "group", "resource", "below"), ALLOWED)
def test_a_part_may_do_what_it_must(
    watching: Stack, part: str, verb: str, group: str, resource: str, below: str
) -> None:
    """Otherwise the next test would say nothing."""
    assert may(watching, part, verb, group, resource, below)


@pytest.mark.parametrize("part", PARTS)
def test_a_part_may_do_nothing_else(watching: Stack, part: str) -> None:
    """No Secret, no other's process, no kubelet's proxy."""
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
    from rigel_k8s.observability.desired import render_stack
    from rigel_k8s.observability.options import request_of

    for item in render_stack(request_of(UNRUN[what]), namespace).desired.objects:
        made = cluster.apply(item, dry_run=True, force=True)
        assert made["metadata"]["name"] == item["metadata"]["name"]


def test_pods_have_series_of_cadvisor_and_no_metrics_server(cluster: Any) -> None:
    """Each pod's processor and memory are in the kubelet's answer; metrics.k8s.io is nobody's."""
    node = cluster.nodes()[0]["metadata"]["name"]

    def are_measured() -> bool:
        """Whether the first of its pods is; one that has just started is not yet."""
        ref = ObjectRef("v1", "Node", "", node)
        running = f"spec.nodeName={node},status.phase=Running"
        pod = cluster.list("v1", "Pod", fields=running)[0]["metadata"]["name"]
        lines = cluster.get_through_proxy(ref, "metrics/cadvisor").decode().splitlines()
        return all(
            any(line.startswith(name) and f'pod="{pod}"' in line for line in lines)
            for name in ("container_cpu_usage_seconds_total", "container_memory_working_set_bytes")
        )

    until(are_measured, "processor and memory of a pod")
    assert not cluster.serves("metrics.k8s.io/v1beta1", "PodMetrics")

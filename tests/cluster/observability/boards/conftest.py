"""Two applications in trouble, and the stack that watches them: made once for all tests here."""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs
import pytest
import yaml

from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.refs import ObjectRef

from ...conftest import run_rigel

PROGRAM = (Path(__file__).parent / "node.py").read_text()
#: Seconds: a pod's start, three scrapes, a rule's `for` of two minutes, and a machine that is busy.
PATIENCE = 600
METRICS = {
    "topics": ["/scan", "/diagnostics"],
    "diagnostics": True,
    "clock": True,
    "tf": True,
    "interval": "5s",
}

Samples = list[dict[str, Any]]


@attrs.frozen
class Watch:
    """Asks the stack's Prometheus and Loki, through the API server."""

    cluster: Any
    namespace: str

    def prometheus(self, path: str, **query: object) -> Any:
        return self._ask("prometheus", 9090, f"api/v1/{path}", query)

    def loki(self, path: str, **query: object) -> Any:
        return self._ask("loki", 3100, f"loki/api/v1/{path}", query)

    def _ask(self, name: str, port: int, path: str, query: dict[str, object]) -> Any:
        service = ObjectRef("v1", "Service", self.namespace, name)
        answer = json.loads(self.cluster.get_through_proxy(service, path, port=port, query=query))
        assert answer["status"] == "success", answer
        return answer["data"]

    def now(self, expr: str) -> Samples:
        """Return what Prometheus answers now."""
        found: Samples = self.prometheus("query", query=expr)["result"]
        return found


@attrs.frozen
class Troubled:
    """The applications: `sick` has a dead node and a silent topic, `forgetful` a new roscore."""

    sick: str
    forgetful: str
    watch: Watch


def until(found: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Return the first true answer; after `patience` seconds say what did not come."""
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline:
        try:
            if answer := found():
                return answer
        except Refusal as refused:
            if refused.status != 503:  # nothing is ready behind the Service for a moment
                raise
        time.sleep(0.5)
    raise AssertionError(f"{what}: not within {patience:g} s")


def inside(cluster: Any, namespace: str, workload: str, command: str) -> None:
    """Run a shell command in a workload's pod."""
    (pod,) = cluster.list("v1", "Pod", namespace, labels={"app.kubernetes.io/name": workload})
    name, container = pod["metadata"]["name"], pod["spec"]["containers"][0]["name"]
    done = cluster.run(namespace, name, ["/bin/sh", "-c", command], container=container)
    assert done.code == 0, done


def node(*words: str) -> dict[str, Any]:
    """Return a node of the Rigelfile: it publishes and hears what the words say."""
    return {"args": ["python3", "-c", PROGRAM, *words]}


def wrap(*words: str) -> dict[str, Any]:
    """Return a node whose container outlives it, and whose pod is always Ready."""
    line = 'python3 -c "$0" "$@"; sleep 100000'
    return {"args": ["sh", "-c", line, PROGRAM, *words], "readiness": "none"}


@pytest.fixture(scope="session")
def watch(stack: str, cluster: Any) -> Watch:
    """The stack's Prometheus and Loki."""
    return Watch(cluster, stack)


@pytest.fixture(scope="session")
def deployed(
    cluster: Any,
    context: str,
    base_image: str,
    exporter_image: str,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Callable[..., str]]:
    """Deploy an application with ROS metrics into a namespace of its own, deleted at the end."""
    made: list[str] = []

    def deploy(name: str, nodes: dict[str, Any], **more: Any) -> str:
        namespace = f"t-{name}-{uuid.uuid4().hex[:6]}"
        made.append(namespace)
        options = {
            "namespace": namespace,
            "deployment_name": name,
            "deploy_ros_master": True,
            "ros_master_image": base_image,
            "nodes": {key: {"image": base_image, **value} for key, value in nodes.items()},
            "observability": {
                "enabled": True,
                "grafana": {"enabled": False},  # no registry here has it
                "ros_metrics": {"image": exporter_image, **METRICS},
            },
            **more,
        }
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        folder = tmp_path_factory.mktemp(name)
        text = yaml.safe_dump({"application": {"distro": "noetic"}, "jobs": {"deploy": job}})
        (folder / "Rigelfile").write_text(text)
        run_rigel("--context", context, "run", "job", "deploy", cwd=folder)
        return namespace

    yield deploy
    for namespace in made:
        cluster.delete(ObjectRef("v1", "Namespace", "", namespace))


@pytest.fixture(scope="session")
def healthy(deployed: Callable[..., str], watch: Watch) -> Troubled:
    """Both applications as they were deployed, all nodes up and the topics flowing."""
    sick = deployed(
        "sick",
        {
            "sensor": node("sensor", "/scan,/diagnostics,/clock,/tf", ""),
            "listener": node("listener", "", "/scan,/nobody"),
            "victim": wrap("victim", "/beat", ""),
        },
        expect={"/scan": {"rate": "0.2.."}},
    )
    forgetful = deployed("forgetful", {"talker": node("talker", "/scan", "")}, gate=False)
    wanted = {sick: {"/sensor", "/listener", "/victim"}, forgetful: {"/talker"}}
    for namespace, nodes in wanted.items():
        up = f'ros_node_up{{namespace="{namespace}", workload!=""}} == 1'
        until(
            lambda up=up, nodes=nodes: nodes <= {x["metric"]["ros_node"] for x in watch.now(up)},
            f"all nodes up in {namespace}",
        )
        flows = f'topic:ros_topic_messages:rate5m{{namespace="{namespace}", topic="/scan"}} > 0.5'
        until(lambda flows=flows: watch.now(flows), f"/scan flows in {namespace}")
    return Troubled(sick, forgetful, watch)


@pytest.fixture(scope="session")
def quiet(healthy: Troubled) -> Sequence[dict[str, Any]]:
    """The alerts that fire about two applications that were just deployed."""
    both = f'namespace=~"{healthy.sick}|{healthy.forgetful}"'
    return healthy.watch.now(f'ALERTS{{alertstate="firing", {both}}}')


@pytest.fixture(scope="session")
def troubled(healthy: Troubled, quiet: Sequence[dict[str, Any]], cluster: Any) -> Troubled:
    """A node is killed, a topic falls silent, a roscore is restarted: all at once."""
    inside(cluster, healthy.sick, "victim", "kill -9 $(cat /tmp/pid)")
    inside(cluster, healthy.sick, "sensor", "touch /tmp/quiet")
    inside(cluster, healthy.forgetful, "ros-master", "kill -INT 1")
    return healthy

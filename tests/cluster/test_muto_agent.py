"""Muto's agent in a pod of a real cluster, with Debian's mosquitto in another one.

What needs no Kubernetes is shown in tests/unit/muto/agent/.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s import __version__
from rigel_k8s.objects.refs import ObjectRef
from rigel_lab.cluster.oci import push_archive
from tests.support import broker_image, shared
from tests.support.mosquitto import Peer
from tests.support.recorder import Recorder
from tests.support.until import until

from .conftest import run_rigel
from .robot import Robot

pytestmark = pytest.mark.cluster

THING = "org.example.robots:robot-7"
ANSWERS = "db/answers"
#: Seconds that a busy machine may take for a stack: a lost first packet alone takes 133 (robot.py).
WITHIN = 300.0


@pytest.fixture(scope="session")
def agent_image(registry: str) -> str:
    """The agent's image in the cluster's registry."""
    name = f"{registry}/muto-agent:{__version__}"
    words = ("image", "muto-agent", "--push", name)
    shared.once("muto-agent", lambda: run_rigel(*words, timeout=shared.BUILDS))
    return name


@pytest.fixture(scope="session")
def mosquitto_image(registry: str) -> str:
    """Debian's mosquitto in the cluster's registry."""

    def push() -> None:
        push_archive(broker_image.build(Recorder()).archive, "mosquitto:test", registry)

    shared.once("mosquitto", push)
    return f"{registry}/mosquitto:test"


AGENT = {"thing": THING, "job": "deploy", "whole_stacks": True, "broker": "mqtt://mosquitto"}


def write_jobs(robot: Robot, image: str, agent_image: str) -> None:
    """Write a Rigelfile with a broker and an agent beside the job `deploy`."""
    robot.write({"a": {"readiness": "none"}}, deployment_name="robot", ros_master_uri="http://r:1")
    rigelfile = json.loads(robot.file.read_text())
    place = {"namespace": robot.namespace}
    broker = {**place, "deployment_name": "broker", "ros": "none", "network": "none"}
    rigelfile["jobs"] |= {
        "broker": {
            "plugin": "rigel_k8s.OrchestrationPlugin",
            "with": {
                **broker,
                "nodes": {"mosquitto": {"ros": "none", "image": image, "ports": [1883]}},
            },
        },
        "agent": {
            "plugin": "rigel_k8s.MutoAgentPlugin",
            "with": {**place, **AGENT, "image": agent_image},
        },
    }
    robot.file.write_text(json.dumps(rigelfile))


@contextmanager
def reach_broker(robot: Robot, cluster: Any) -> Iterator[Peer]:
    """A client of the broker in the pod."""
    [pod] = robot.pods("mosquitto")
    with (
        cluster.port_forward(robot.namespace, pod["metadata"]["name"], {1883: 0}) as opened,
        Peer(opened.ports[1883], ANSWERS) as peer,
    ):
        yield peer


def start_in_pod(robot: Robot, peer: Peer) -> None:
    """Start a stack by the agent in its pod, and wait until it is ready."""
    node = {"name": "a", "pkg": "topic_tools", "exec": "relay", "args": "/in /out"}
    stack = json.dumps({"stackId": "org:a", "node": [node]})
    topic = f"{THING}/stack/commands/start"
    peer.send(topic, stack.encode(), response_topic=ANSWERS, correlation=b"1")
    answer = json.loads(peer.receive().payload)
    assert answer.get("result") == "success", answer
    until(lambda: robot.ready("a"), "the stack", seconds=WITHIN)


@pytest.mark.slow  # builds two images
def test_the_agent_runs_in_a_pod(
    tmp_path: Path,
    namespace: str,
    base_image: str,
    agent_image: str,
    mosquitto_image: str,
    rigel: Any,
    cluster: Any,
) -> None:
    """With the rights of its Role alone; it is ready when it hears its broker.

    When its own pod is gone, the nodes run on.
    """
    robot = Robot(tmp_path, namespace, base_image, rigel, cluster)
    write_jobs(robot, mosquitto_image, agent_image)
    robot.rigel("run", "job", "broker", "--timeout", "2m")
    robot.rigel("run", "job", "agent", "--timeout", "2m")
    assert robot.ready("muto-agent")
    with reach_broker(robot, cluster) as peer:
        start_in_pod(robot, peer)
    [agent], [node] = robot.pods("muto-agent"), robot.pods("a")
    cluster.delete(ObjectRef("v1", "Pod", namespace, agent["metadata"]["name"]))
    until(lambda: robot.ready("muto-agent"), "the next agent", seconds=WITHIN)
    [there] = robot.pods("a")
    assert there["metadata"]["uid"] == node["metadata"]["uid"]

"""Muto's agent on a real cluster: Debian's mosquitto, and a stand-in for Ditto, on this machine.

What needs no Kubernetes is shown in tests/unit/muto/agent/.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import attrs
import pytest
from paho.mqtt.client import MQTTv311

from rigel_k8s import __version__
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import revisions
from rigel_k8s.release.types import ReleaseId
from rigel_lab.cluster.oci import push_archive
from rigel_muto.agent.address import Login
from tests.support import broker_image, shared
from tests.support.certificates import AUTHORITY, Authority
from tests.support.http_server import Exchange, HttpServer, serving
from tests.support.mosquitto import Mosquitto, Peer, running
from tests.support.recorder import Recorder
from tests.support.until import until

from .conftest import run_rigel
from .robot import Robot

pytestmark = pytest.mark.cluster

THING = "org.example.robots:robot-7"
ANSWERS = "db/answers"
#: Seconds that a busy machine may take for a stack: a lost first packet alone takes 133 (robot.py).
WITHIN = 300.0


def relay(name: str, **more: Any) -> dict[str, Any]:
    """Return a node that is in every base image."""
    args = f"/in_{name} /out_{name}"
    return {"name": name, "pkg": "topic_tools", "exec": "relay", "args": args, **more}


STACKS = {
    "org.example.robots:one": [relay("a", param=[{"name": "rate", "value": "2"}]), relay("both")],
    "org.example.robots:two": [relay("b"), relay("both")],
    "org.example.robots:three": [relay("c"), relay("both")],
}


@attrs.define
class Things:
    """A Ditto with the stacks, and with what the agent says of the device."""

    device: dict[str, Any] | None = None
    states: list[dict[str, str]] = attrs.field(factory=list)
    lock: threading.Lock = attrs.field(factory=threading.Lock)

    def answer(self, exchange: Exchange) -> None:
        request = exchange.request_
        name, _, rest = request.path.removeprefix("/api/2/things/").partition("/")
        with self.lock:
            if request.method == "GET" and name in STACKS:
                stack = {"stackId": name, "node": STACKS[name]}
                exchange.say(200, {"features": {"stack": {"properties": stack}}})
            elif name == THING and request.method == "PUT" and not rest:
                self.device = request.json
                exchange.say(201)
            elif name == THING and self.device is not None:
                if rest:
                    self.states.append(request.json)
                exchange.say(204)
            else:
                exchange.say(404)

    def until(self, stack: str, state: str) -> None:
        """Wait until the twin says this."""
        wanted = {"stackId": stack, "state": state}
        until(
            lambda: self.states[-1:] == [wanted],
            f"{state} of {stack}",
            seconds=WITHIN,
            last_words=lambda: str(self.states[-3:]),
        )


@attrs.define
class AgentProcess:
    """`rigel muto agent` in a process of its own, with the memory settings of its pod."""

    words: list[str]
    log: Path
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, and wait until it hears the broker."""
        before = self.read_log().count("connected to")
        with self.log.open("ab") as log:
            environ = {**os.environ, "MALLOC_ARENA_MAX": "2"}  # as in its pod
            self.process = subprocess.Popen(self.words, stdout=log, stderr=log, env=environ)
        self.until_connected(before + 1)

    def until_connected(self, times: int) -> None:
        until(
            lambda: self.read_log().count("connected to mqtt") >= times,
            "the broker",
            seconds=WITHIN,
            last_words=self.read_log,
        )

    def kill(self) -> None:
        """End it at once."""
        assert self.process
        self.process.kill()
        self.process.wait()

    def read_log(self) -> str:
        return self.log.read_text() if self.log.exists() else ""


@attrs.frozen
class Device:
    """All that is there of one device."""

    robot: Robot
    broker: Mosquitto
    twin: Things
    agent: AgentProcess

    def send(self, peer: Peer, command: str, **payload: Any) -> Any:
        """Send a command of the ROS 1 generation, and return its answer."""
        correlation = str(time.monotonic_ns()).encode()
        peer.send(
            f"{THING}/{command}",
            json.dumps(payload).encode(),
            response_topic=ANSWERS,
            correlation=correlation,
        )
        message = peer.receive()
        assert message.properties.CorrelationData == correlation  # type: ignore[union-attr]
        return json.loads(message.payload)

    def start(self, peer: Peer, name: str, method: str = "start") -> None:
        answer = self.send(peer, f"stack/commands/{method}", name=name, stackId=name)
        assert answer["result"] == "success", answer


@pytest.fixture
def twin() -> Iterator[tuple[Things, HttpServer]]:
    things = Things()
    with serving(things.answer) as server:
        yield things, server


@pytest.fixture
def device(
    tmp_path: Path,
    namespace: str,
    base_image: str,
    rigel: Any,
    cluster: Any,
    context: str,
    deployer_config: Path,
    twin: tuple[Things, HttpServer],
) -> Iterator[Device]:
    """A device whose agent has the Role for deployers, and nothing else."""
    robot = Robot(tmp_path, namespace, base_image, rigel, cluster)
    robot.write({}, deployment_name="robot")
    things, server = twin
    directory = tmp_path / "broker"
    directory.mkdir()
    with running(directory) as broker:
        words = [sys.executable, "-m", "rigel_k8s", "-f", str(robot.file), "-n", namespace]
        words += ["--kubeconfig", str(deployer_config), "--context", context, "muto", "agent"]
        words += ["--thing", THING, "--broker", f"mqtt://127.0.0.1:{broker.port}"]
        words += ["--job", "deploy", "--twin-url", server.url, "--whole-stacks"]
        agent = AgentProcess(words, tmp_path / "agent.log")
        agent.start()
        try:
            yield Device(robot, broker, things, agent)
        finally:
            agent.kill()
            print(agent.read_log())  # noqa: T201 - what pytest shows of a failure


def uids(device: Device, *names: str) -> list[str]:
    return [device.robot.pods(name)[0]["metadata"]["uid"] for name in names]


def test_a_device_obeys_and_its_twin_tells_the_truth(device: Device) -> None:
    """Start, apply, an agent that is killed, a broker that is away, and kill."""
    one, two, three = STACKS
    with Peer(device.broker.port, ANSWERS) as peer:
        device.start(peer, one)
        device.twin.until(one, "active")
        assert device.twin.states[0] == {"stackId": one, "state": "starting"}
        assert device.robot.deployments() == {"ros-master", "a", "both"}
        assert device.robot.ready("a")
        before = uids(device, "ros-master", "both")

        def ask(question: str, **arguments: str) -> dict[str, Any]:
            """Ask until the agent gets an answer in the seconds that it has for one."""
            command = f"agent/commands/ros/{question}"
            known = "nodes" if question == "node" else "name"
            return until(
                lambda: known in (said := device.send(peer, command, **arguments)) and said,
                f"answer to {question}",
                seconds=WITHIN,
            )

        assert {"/a", "/both"} <= {node["name"] for node in ask("node")["nodes"]}
        assert ask("param/get", param="/a/rate") == {"name": "/a/rate", "value": 2}

        device.start(peer, two, "apply")
        device.twin.until(two, "active")
        assert device.robot.deployments() == {"ros-master", "b", "both"}
        assert uids(device, "ros-master", "both") == before

        device.start(peer, three)
        device.twin.until(three, "starting")
        device.agent.kill()
        assert device.twin.states[-1] == {"stackId": three, "state": "starting"}
        device.agent.start()
        device.twin.until(three, "active")
        assert uids(device, "ros-master", "both") == before

    seen = device.agent.read_log().count("connected to mqtt")
    device.broker.kill()
    device.broker.start()
    device.agent.until_connected(seen + 1)
    with Peer(device.broker.port, ANSWERS) as peer:
        device.start(peer, three, "kill")
    device.twin.until(three, "killed")
    assert device.robot.deployments() == set()


def test_symphony_applies_and_removes(device: Device) -> None:
    """A GET lists what is ready; an answer of POST comes before that."""
    device.robot.write(
        {"a": {"readiness": "none"}}, deployment_name="robot", ros_master_uri="http://robot:11311"
    )
    stack = json.dumps({"node": [relay("a")]})
    data = base64.b64encode(stack.encode()).decode()
    component = {"name": "relay", "properties": {"type": "stack", "data": data}}
    spec = {"solution": {"spec": {"components": [component]}}, "activeTarget": "robot-7"}
    body = base64.b64encode(json.dumps(spec).encode()).decode()

    def ask(method: str) -> Any:
        metadata = {"request-id": str(time.monotonic_ns()), "active-target": "robot-7"}
        request = {"method": method, "route": "instances", "body": body, "metadata": metadata}
        peer.send("muto/coa-request", json.dumps(request).encode())
        answer = json.loads(peer.receive().payload)
        assert answer["metadata"]["request-id"] == metadata["request-id"]
        assert answer["state"] == 200, base64.b64decode(answer["body"])
        return json.loads(base64.b64decode(answer["body"]))

    with Peer(device.broker.port, "muto/coa-response", version=MQTTv311) as peer:
        began = ask("POST")["targets"]["robot-7"]["components"]["relay"]
        assert began["status"] == 8004
        until(lambda: ask("GET") == [component], "the component", seconds=WITHIN, every=1.0)
        assert device.robot.ready("a")
        ask("DELETE")
        until(lambda: device.robot.deployments() == set(), "its end", seconds=WITHIN)
        assert ask("GET") == []
    memory = ObjectRef("v1", "Secret", device.robot.namespace, "rigel.robot.muto-agent")
    assert device.robot.cluster.get(memory) is not None


#: How many commands come in a row.
MANY = 1000


def choose_command(number: int) -> tuple[str, dict[str, Any]]:
    """Return one of mixed commands; the last one is a start of the third stack."""
    one, two, three = STACKS
    if number == MANY - 1:
        return "stack/commands/start", {"stackId": three}
    return (
        ("stack/commands/start", {"stackId": one}),
        ("agent/commands/ping", {"number": number}),
        ("stack/commands/apply", {"stackId": two}),
        ("stack/commands/kill", {}),
    )[number % 4]


def read_memory(process: subprocess.Popen[bytes] | None) -> int:
    """Return the mebibytes that a process has in memory."""
    assert process
    status = Path(f"/proc/{process.pid}/status").read_text()
    [line] = [line for line in status.splitlines() if line.startswith("VmRSS:")]
    return int(line.split()[1]) // 1024


@pytest.mark.slow  # takes half an hour on two busy cores
@pytest.mark.timeout(7200)
def test_a_thousand_commands_in_a_row(device: Device) -> None:
    """Each has one answer, the last one wins, and neither memory nor history grows with them."""
    release = ReleaseId(device.robot.namespace, "robot")
    began, memory, kept = time.monotonic(), [], []
    with Peer(device.broker.port, ANSWERS) as peer:
        for number in range(MANY):
            command, payload = choose_command(number)
            text, correlation = json.dumps(payload).encode(), str(number).encode()
            topic = f"{THING}/{command}"
            peer.send(topic, text, response_topic=ANSWERS, correlation=correlation)
        for number in range(MANY):
            message = peer.receive()
            assert message.properties.CorrelationData == str(number).encode()  # type: ignore[union-attr]
            command, payload = choose_command(number)
            answer = json.loads(message.payload)
            assert answer == payload if "ping" in command else answer["result"] == "success", answer
            if number % 100 == 99:
                memory.append(read_memory(device.agent.process))
                kept.append(len(revisions.records(device.robot.cluster, release)))
        answered = time.monotonic() - began
        *_, three = STACKS
        device.twin.until(three, "active")
        assert device.robot.deployments() == {"ros-master", "c", "both"}
        device.send(peer, "agent/commands/ping")
        assert peer.received.empty()
    history = json.loads(device.robot.rigel("history", "deploy", "-o", "json").stdout)
    secrets = device.robot.cluster.list("v1", "Secret", device.robot.namespace)
    sizes = {item["metadata"]["name"]: len(json.dumps(item)) for item in secrets}
    print(f"{MANY} commands: {answered:.0f} s, MiB {memory}, {kept}, {history}, {sizes}")  # noqa: T201
    assert memory[-1] < memory[0] + 50, "the pod has 512 MiB"
    assert max(kept) <= 2 * revisions.LIMIT, "the good ones, and those that did not end"
    assert len(history) <= revisions.LIMIT


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


AGENT = {"thing": THING, "job": "deploy", "whole_stacks": True}


def write_jobs(robot: Robot, image: str, agent_image: str, node: Any, **agent: Any) -> None:
    """Write a Rigelfile with a broker and an agent beside the job `deploy`."""
    robot.write({"a": {"readiness": "none"}}, deployment_name="robot", ros_master_uri="http://r:1")
    rigelfile = json.loads(robot.file.read_text())
    place = {"namespace": robot.namespace}
    broker = {**place, "deployment_name": "broker", "ros": "none", "network": "none"}
    rigelfile["jobs"] |= {
        "broker": {
            "plugin": "rigel_k8s.OrchestrationPlugin",
            "with": {**broker, "nodes": {"mosquitto": {"ros": "none", "image": image, **node}}},
        },
        "agent": {
            "plugin": "rigel_k8s.MutoAgentPlugin",
            "with": {**place, **AGENT, "image": agent_image, **agent},
        },
    }
    robot.file.write_text(json.dumps(rigelfile))


@contextmanager
def reach_broker(robot: Robot, cluster: Any, port: int, **options: Any) -> Iterator[Peer]:
    """A client of the broker in the pod."""
    [pod] = robot.pods("mosquitto")
    with (
        cluster.port_forward(robot.namespace, pod["metadata"]["name"], {port: 0}) as opened,
        Peer(opened.ports[port], ANSWERS, **options) as peer,
    ):
        yield peer


def start_in_pod(robot: Robot, peer: Peer) -> None:
    """Start a stack by the agent in its pod, and wait until it is ready."""
    stack = json.dumps({"stackId": "org:a", "node": [relay("a")]})
    topic = f"{THING}/stack/commands/start"
    peer.send(topic, stack.encode(), response_topic=ANSWERS, correlation=b"1")
    answer = json.loads(peer.receive().payload)
    assert answer["result"] == "success", answer
    until(lambda: robot.ready("a"), "the stack", seconds=WITHIN)


@pytest.mark.slow  # builds two images; what the agent does is shown above
def test_the_agent_runs_in_a_pod(
    tmp_path: Path,
    namespace: str,
    base_image: str,
    agent_image: str,
    mosquitto_image: str,
    rigel: Any,
    cluster: Any,
) -> None:
    """With the rights of its Role alone; it is ready when it hears its broker."""
    robot = Robot(tmp_path, namespace, base_image, rigel, cluster)
    write_jobs(robot, mosquitto_image, agent_image, {"ports": [1883]}, broker="mqtt://mosquitto")
    robot.rigel("run", "job", "broker", "--timeout", "2m")
    robot.rigel("run", "job", "agent", "--timeout", "2m")
    assert robot.ready("muto-agent")
    with reach_broker(robot, cluster, 1883) as peer:
        start_in_pod(robot, peer)


#: How a broker with TLS and a password is set up; the files are a Secret's.
SECURE = """
listener 8883
cafile /tls/ca.crt
certfile /tls/tls.crt
keyfile /tls/tls.key
password_file /tls/passwords
allow_anonymous false
"""


def make_secret(namespace: str, name: str, files: Mapping[str, str]) -> dict[str, Any]:
    meta = {"namespace": namespace, "name": name}
    return {"apiVersion": "v1", "kind": "Secret", "metadata": meta, "stringData": dict(files)}


@pytest.mark.slow  # as above
def test_an_agent_in_a_pod_logs_in_by_tls_and_a_secret(
    tmp_path: Path,
    namespace: str,
    base_image: str,
    agent_image: str,
    mosquitto_image: str,
    rigel: Any,
    cluster: Any,
) -> None:
    """A wrong authority and a wrong password are one error each, in its log and in its status.

    A Secret that is mended is used without a restart.
    """
    authority = Authority(tmp_path)
    root, other = authority.make("root", AUTHORITY), authority.make("other", AUTHORITY)
    names = "subjectAltName=DNS:mosquitto,IP:127.0.0.1\n"
    server = authority.make("server", names, "root")
    words = ["mosquitto_passwd", "-c", "-b", tmp_path / "passwords", "robot", "right"]
    subprocess.run(words, check=True, timeout=30)
    files = {
        "ca.crt": root.read_text(),
        "tls.crt": server.read_text(),
        "tls.key": server.with_suffix(".key").read_text(),
        "passwords": (tmp_path / "passwords").read_text(),
        "mosquitto.conf": SECURE,
    }
    cluster.create(make_secret(namespace, "tls", files))
    right = {"username": "robot", "password": "right", "ca.crt": root.read_text()}
    for name, wrong in (
        ("password", {"password": "wrong"}),
        ("authority", {"ca.crt": other.read_text()}),
    ):
        cluster.create(make_secret(namespace, f"wrong-{name}", right | wrong))

    robot = Robot(tmp_path, namespace, base_image, rigel, cluster)
    node = {
        "command": ["/usr/sbin/mosquitto", "-c", "/tls/mosquitto.conf"],
        "ports": [8883],
        "volumes": [{"secret": "tls", "mount_path": "/tls"}],
    }

    def write(secret: str) -> None:
        url = "mqtts://mosquitto"
        write_jobs(robot, mosquitto_image, agent_image, node, broker=url, broker_secret=secret)

    def fail(secret: str, cause: str) -> None:
        """Deploy an agent with this Secret, and look where the cause is."""
        write(secret)
        done = robot.rigel("run", "job", "agent", "--timeout", "30s", check=False)
        assert done.returncode != 0
        line = f"no connection to mqtts://mosquitto:8883: {cause}"
        assert line in done.stdout + done.stderr
        assert line in robot.rigel("status", "agent", check=False).stdout
        log = robot.rigel("logs", "--job", "agent").stdout
        assert log.count("no connection to") == log.count(line) == 1, log

    write("wrong-password")
    robot.rigel("run", "job", "broker", "--timeout", "2m")
    fail("wrong-password", 'the broker refuses the user "robot": Not authorized')
    fail("wrong-authority", "its certificate is not trusted: ")

    secret = ObjectRef("v1", "Secret", namespace, "wrong-authority")
    cluster.apply(make_secret(namespace, secret.name, right))
    until(lambda: robot.ready("muto-agent"), "the agent", seconds=2 * WITHIN, every=1.0)
    trusting = Login(authorities=root).make_context()
    options = {"username": "robot", "password": "right", "context": trusting}
    with reach_broker(robot, cluster, 8883, **options) as peer:
        start_in_pod(robot, peer)

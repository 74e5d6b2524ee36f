"""The agent as a whole: a real broker on one side, a release on the fake cluster on the other."""

from __future__ import annotations

import base64
import itertools
import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import MQTTv311

from rigel_k8s.errors import UserError
from rigel_k8s.settings import Settings
from rigel_muto.agent.address import Login
from rigel_muto.agent.allowance import Allowance
from rigel_muto.execution import serving
from rigel_muto.execution.serving import read_login, serve_health
from tests.support.mosquitto import Mosquitto, Peer, find_port, running
from tests.support.recorder import Recorder
from tests.support.until import until

from .conftest import Agent, stack

pytestmark = pytest.mark.programs

THING = "org:robot"
ANSWERS = "db/answers"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    directory = tmp_path / "broker"
    directory.mkdir()
    with running(directory) as found:
        yield found


def connected(broker: Mosquitto) -> str:
    """Return what an agent prints when it hears a broker."""
    return f"connected to mqtt://127.0.0.1:{broker.port}"


@contextmanager
def serve(agent: Agent, broker: Mosquitto, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run an agent until the end of the block."""
    ending = threading.Event()
    told = serving.Agent(
        thing=THING,
        broker=f"mqtt://127.0.0.1:{broker.port}",
        allowance=Allowance(whole_stacks=True),
    )

    @contextmanager
    def interruptible() -> Iterator[threading.Event]:
        yield ending

    monkeypatch.setattr(serving, "connect", lambda settings: agent.fake)
    monkeypatch.setattr(serving, "interruptible", interruptible)
    settings = Settings(rigelfile=agent.directory / "Rigelfile", timeout=30)
    thread = threading.Thread(target=serving.run, args=(told, settings, agent.report))
    before = agent.report.lines.count(connected(broker))
    thread.start()
    try:
        until(lambda: agent.report.lines.count(connected(broker)) > before, "the connection")
        yield
    finally:
        ending.set()
        thread.join(30)


def receive(peer: Peer) -> Any:
    return json.loads(peer.receive().payload)


def send_start(peer: Peer, text: str, correlation: bytes) -> None:
    topic = f"{THING}/stack/commands/start"
    peer.send(topic, text.encode(), response_topic=ANSWERS, correlation=correlation)


def encode_request(method: str, number: int, **components: str) -> bytes:
    """Return a request as Symphony's provider encodes it."""
    listed = [
        {
            "name": name,
            "type": "muto-agent",
            "properties": {"type": "stack", "data": base64.b64encode(text.encode()).decode()},
        }
        for name, text in components.items()
    ]
    spec = {"solution": {"spec": {"components": listed}}, "activeTarget": "robot"}
    request = {
        "method": method,
        "route": "instances",
        "contentType": "",
        "body": base64.b64encode(json.dumps(spec).encode()).decode(),
        "metadata": {"request-id": str(number), "active-target": "robot"},
    }
    return json.dumps(request).encode()


def test_commands_of_all_protocols_reach_the_release(
    agent: Agent, broker: Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same release: what one has started another one removes."""
    with serve(agent, broker, monkeypatch), Peer(broker.port, ANSWERS) as peer:
        send_start(peer, stack("org:x", "c"), b"1")
        assert receive(peer)["result"] == "success"
        assert agent.nodes == {"c"}
        live = {
            "topic": "org/robot/things/live/messages/stack/commands/kill",
            "headers": {"reply-to": ANSWERS, "correlation-id": "2"},
            "path": "/inbox/messages/stack/commands/kill",
            "value": {"stackId": "org:x"},
        }
        peer.send(f"muto/{THING}", json.dumps(live).encode())
        assert receive(peer)["path"].startswith("/outbox")
        until(lambda: agent.nodes == set(), "the end of the stack")


def test_symphony_applies_and_removes_components(
    agent: Agent, broker: Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GET lists a component when it is ready, and no longer when it is removed."""
    texts = {"one": stack("org:1", "a"), "two": stack("org:2", "b")}
    answers = "muto/coa-response"
    numbers = itertools.count()

    def ask(method: str, **components: str) -> Any:
        peer.send("muto/coa-request", encode_request(method, next(numbers), **components))
        answer = receive(peer)
        assert answer["state"] == 200, answer
        return json.loads(base64.b64decode(answer["body"]))

    with serve(agent, broker, monkeypatch), Peer(broker.port, answers, version=MQTTv311) as peer:
        assert ask("GET", **texts) == []
        ask("POST", **texts)
        until(lambda: [one["name"] for one in ask("GET", **texts)] == ["one", "two"], "both")
        assert agent.nodes == {"a", "b"}
        ask("DELETE", one=texts["one"])
        until(lambda: [one["name"] for one in ask("GET", **texts)] == ["two"], "the other one")
        until(lambda: agent.nodes == {"b"}, "the end of the other one's node")


def test_kubernetes_learns_why_the_broker_is_not_heard() -> None:
    """From what a probe prints, as its pod runs it."""
    trouble, port = "no connection to mqtt://broker:1883: Not authorized", find_port()

    def probe() -> tuple[int, str]:
        words = [sys.executable, "-m", "rigel_muto.agent.probe", str(port)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=120)
        assert done.stderr == ""
        return done.returncode, done.stdout

    assert probe() == (
        1,
        f"the agent does not answer at port {port}: [Errno 111] Connection refused\n",
    )
    with serve_health(port, lambda: trouble):
        assert probe() == (1, f"{trouble}\n")
        trouble = ""
        assert probe() == (0, "connected to the broker\n")


def test_the_brokers_secret_has_the_names_that_kubernetes_uses(tmp_path: Path) -> None:
    assert read_login(None) == Login()
    for name in ("username", "password", "ca.crt", "tls.crt", "tls.key"):
        (tmp_path / name).write_text("robot\n")
    login = read_login(tmp_path)
    assert (login.user, login.read_password()) == ("robot", "robot")
    assert login.authorities == tmp_path / "ca.crt"
    assert (login.certificate, login.key) == (tmp_path / "tls.crt", tmp_path / "tls.key")
    with pytest.raises(UserError, match=r"the directory .* does not exist"):
        read_login(tmp_path / "missing")


@pytest.mark.parametrize("thing", ["robot", "a:b:c", ":b", "a:"])
def test_what_is_no_id_of_a_thing_is_refused_at_once(thing: str) -> None:
    told = serving.Agent(thing=thing, broker="mqtt://localhost")
    with pytest.raises(UserError, match="is not NAMESPACE:NAME"):
        serving.run(told, Settings(), Recorder())

"""The agent and a real broker: what is sent is carried out once, whoever is away meanwhile."""

from __future__ import annotations

import base64
import json
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import MQTTv311

from rigel_k8s.errors import UserError
from rigel_muto.agent.address import Address, Login
from rigel_muto.agent.broker import Broker
from rigel_muto.agent.commands import Command, Deploy, Outcome, Stage, Unavailable
from tests.support.certificates import AUTHORITY, SERVER, Authority
from tests.support.mosquitto import Mosquitto, Peer, find_port, running
from tests.support.recorder import Recorder
from tests.support.until import until

from . import test_ditto as ditto
from . import test_symphony as symphony
from .agents import START, THING, agent, connect, wait_until_ready
from .recording import Remembering

pytestmark = pytest.mark.programs


@pytest.fixture
def mosquitto(tmp_path: Path) -> Iterator[Mosquitto]:
    with running(tmp_path) as broker:
        yield broker


def name(number: int) -> bytes:
    return json.dumps({"stackId": f"stack-{number}"}).encode()


def names(count: int) -> list[str]:
    return [f"stack-{number}" for number in range(count)]


def test_each_protocol_is_answered(mosquitto: Mosquitto) -> None:
    """Symphony's provider speaks MQTT 3.1.1 without acknowledgements."""
    request = json.dumps(symphony.write("POST", symphony.deploy(symphony.component()))).encode()
    message = json.dumps(ditto.write("agent/commands/ping", "hello")).encode()
    with agent(mosquitto.port) as running_agent, Peer(mosquitto.port, "answers") as peer:
        peer.send(START, name(0), response_topic="answers", correlation=b"\x01\xff")
        answer = peer.receive()
        assert answer.properties.CorrelationData == b"\x01\xff"  # type: ignore[union-attr]
        assert json.loads(answer.payload)["command"] == START

        peer.send(ditto.OWN, message)
        answer = peer.receive()
        assert json.loads(answer.payload)["value"] == "hello"
        assert answer.properties.CorrelationData == b"c1"  # type: ignore[union-attr]

        with Peer(mosquitto.port, symphony.RESPONSES, version=MQTTv311) as provider:
            provider.send(symphony.REQUESTS, request, qos=0)
            response = json.loads(provider.receive().payload)
        assert response["metadata"] == {"request-id": "r-1"}
        assert response["state"] == 200
        assert json.loads(base64.b64decode(response["body"]))["successCount"] == 1
        assert len(running_agent.executor.commands) == 2


def test_a_thousand_commands_in_a_row_are_carried_out_in_their_order(mosquitto: Mosquitto) -> None:
    with (
        agent(mosquitto.port) as running_agent,
        Peer(mosquitto.port) as peer,
    ):
        for number in range(999):
            peer.send(START, name(number), wait=False)
        peer.send(START, name(999))
        assert running_agent.wait_for(1000) == names(1000)


def settle(peer: Peer) -> None:
    """Return when the broker has all acknowledgements of what was sent before."""
    peer.send(f"{THING}/agent/commands/ping", b"", response_topic="answers")
    peer.receive()


def list_rest(mosquitto: Mosquitto) -> list[str]:
    """Return the topics of the commands that the broker still keeps for the agent."""
    reporter = Recorder()
    with connect(mosquitto.port, reporter) as broker, Peer(mosquitto.port) as peer:
        wait_until_ready(broker, reporter)
        peer.send(f"{THING}/end", b"")
        found = []
        while (delivery := broker.next(30)) and delivery.arrival.topic != f"{THING}/end":
            if delivery.arrival.topic == START:
                found.append(delivery.arrival.topic)
        assert delivery
        broker.acknowledge(delivery)
        return found


@pytest.mark.parametrize("end", ["killed", "frozen"])
@pytest.mark.parametrize("seconds", [2, pytest.param(60, marks=pytest.mark.slow)])
def test_a_broker_that_is_away_for_long_loses_and_repeats_nothing(
    mosquitto: Mosquitto, end: str, seconds: float
) -> None:
    """Commands from before that are carried out meanwhile and later ones; each has one answer."""
    go_on = threading.Event()

    def wait(_: Command) -> Outcome:
        go_on.wait(30)
        return Outcome(Stage.ACCEPTED)

    def ask(number: int) -> dict[str, Any]:
        return {"response_topic": "answers", "correlation": str(number).encode()}

    with (
        agent(mosquitto.port, Remembering(wait)) as running_agent,
        Peer(mosquitto.port, "answers", session="peer") as peer,
        Peer(mosquitto.port) as other,
    ):
        for number in range(20):
            peer.send(START, name(number), **ask(number))
        mosquitto.save(name(19))
        began = time.monotonic()
        mosquitto.freeze() if end == "frozen" else mosquitto.kill()
        go_on.set()
        assert running_agent.wait_for(20) == names(20), "the broker is not needed for them"
        if end == "killed":
            until(lambda: not other.is_connected, "end of the connection", every=0.02)
            for number in range(20, 40):
                other.send_later(START, name(number), **ask(number))
        time.sleep(max(0.0, began + seconds - time.monotonic()))
        mosquitto.thaw() if end == "frozen" else mosquitto.start()
        wait_until_ready(running_agent.broker, running_agent.reporter)
        count = 40 if end == "killed" else 20
        peer.send(START, name(count), **ask(count))
        assert sorted(running_agent.wait_for(count + 1)) == sorted(names(count + 1))
        answered = [peer.receive().properties.CorrelationData for _ in range(count + 1)]  # type: ignore[union-attr]
        assert sorted(answered) == sorted(str(number).encode() for number in range(count + 1))
        settle(peer)
        assert len(running_agent.executor.commands) == count + 1
        assert peer.received.empty()
        warnings = running_agent.reporter.warnings
        assert len(warnings) == len(set(warnings)) <= 3, warnings
    assert list_rest(mosquitto) == []


def test_a_connection_that_ends_during_a_command_does_not_repeat_it(mosquitto: Mosquitto) -> None:
    """It is acknowledged when the broker sends it again, although nothing tells duplicates."""
    restarted = threading.Event()

    def restart(command: Command) -> Outcome:
        if not restarted.is_set():
            mosquitto.save(name(0))
            mosquitto.kill()
            mosquitto.start()
            restarted.set()
        return Outcome(Stage.ACCEPTED)

    with (
        agent(mosquitto.port, Remembering(restart)) as running_agent,
        Peer(mosquitto.port, "answers") as peer,
    ):
        peer.send(START, name(0))
        assert restarted.wait(120), running_agent.reporter.texts
        wait_until_ready(running_agent.broker, running_agent.reporter)
        peer.send(START, name(1))
        assert running_agent.wait_for(2) == names(2)
        settle(peer)
    assert list_rest(mosquitto) == []


def test_what_is_sent_while_the_agent_is_away_comes_later(mosquitto: Mosquitto) -> None:
    with agent(mosquitto.port):
        pass
    with Peer(mosquitto.port) as peer:
        for number in range(3):
            peer.send(START, name(number))
    with agent(mosquitto.port) as running_agent:
        assert running_agent.wait_for(3) == names(3)


def test_what_was_not_carried_out_comes_again(mosquitto: Mosquitto) -> None:
    """To an agent that was killed in the middle."""
    reporter = Recorder()
    with connect(mosquitto.port, reporter) as broker, Peer(mosquitto.port) as peer:
        wait_until_ready(broker, reporter)
        peer.send(START, name(0))
        assert broker.next(30)
    with agent(mosquitto.port) as running_agent:
        assert running_agent.wait_for(1) == names(1)


def test_a_command_is_kept_until_it_can_be_stored(mosquitto: Mosquitto) -> None:
    failures = iter([Unavailable("the cluster is away")] * 2)

    def store(_: Command) -> Outcome:
        for failure in failures:
            raise failure
        return Outcome(Stage.ACCEPTED, "stored at last")

    executor = Remembering(store)
    with agent(mosquitto.port, executor) as running_agent, Peer(mosquitto.port, "answers") as peer:
        peer.send(START, name(0), response_topic="answers")
        assert json.loads(peer.receive().payload)["message"] == "stored at last"
        assert running_agent.wait_for(3) == ["stack-0"] * 3
        assert running_agent.reporter.warnings == ["the cluster is away; trying again"]


def test_messages_that_no_one_keeps_do_not_fill_the_memory(
    mosquitto: Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is too much is left out; a command that the broker keeps is not."""
    monkeypatch.setattr("rigel_muto.agent.broker.MOST_WAITING", 0)
    with agent(mosquitto.port) as running_agent, Peer(mosquitto.port) as peer:
        for number in range(5):
            peer.send(START, name(number), qos=0)
        peer.send(START, name(5))
        assert running_agent.wait_for(1) == ["stack-5"]


def test_a_password_that_others_can_read_on_its_way_is_a_warning(tmp_path: Path) -> None:
    reporter, file = Recorder(), tmp_path / "password"
    file.write_text("s3cret")
    login = Login(user="robot", password_file=file)
    for host in ("broker.invalid", "127.0.0.1"):
        address = Address(host, find_port(), tls=False)
        with Broker(address, login, "rigel-r7", [], reporter):
            pass
    [warning] = [text for text in reporter.warnings if "password" in text]
    assert "broker.invalid" in warning
    assert "s3cret" not in str(reporter.texts)


def test_own_answers_and_retained_commands_are_not_heard(mosquitto: Mosquitto) -> None:
    """Who asks could have the answer to a ping kill what runs, or one command never end."""
    with Peer(mosquitto.port, f"{THING}/#") as peer:
        peer.send(START, name(0), retain=True)
        with agent(mosquitto.port) as running_agent:
            kill, ping = f"{THING}/stack/commands/kill", f"{THING}/agent/commands/ping"
            peer.send(ping, b"", response_topic=kill)
            while (message := peer.receive()).topic != kill:
                pass
            assert json.loads(message.payload) == {"asked": "ping"}
            peer.send(START, name(1))
            running_agent.wait_for(1)
            assert running_agent.executor.commands == [Deploy(stack_id="stack-1")]


def test_an_acknowledgement_is_not_taken_for_that_of_another_message(mosquitto: Mosquitto) -> None:
    """A broker that has lost its sessions numbers messages from the beginning again."""
    go_on = threading.Event()

    def store(command: Command) -> Outcome:
        if command == Deploy(stack_id="stack-0"):
            go_on.wait(30)
            return Outcome(Stage.ACCEPTED)
        raise Unavailable("the cluster is away")

    with (
        agent(mosquitto.port, Remembering(store)) as running_agent,
        Peer(mosquitto.port) as peer,
    ):
        peer.send(START, name(0))
        running_agent.wait_for(1)
        mosquitto.kill()
        mosquitto.start()
        until(lambda: len(running_agent.reporter.lines) == 2, "new connection", every=0.02)
        peer.send(START, name(1))
        go_on.set()
        running_agent.wait_for(2)
    assert list_rest(mosquitto) == [START]


def test_a_broker_that_is_away_at_first_is_reported_once(tmp_path: Path) -> None:
    mosquitto = Mosquitto(tmp_path)
    with agent(mosquitto.port, waiting=False) as running_agent:
        until(lambda: running_agent.reporter.warnings, "warning", every=0.02)
        assert not running_agent.broker.is_ready
        try:
            mosquitto.start()
            wait_until_ready(running_agent.broker, running_agent.reporter)
        finally:
            mosquitto.kill()
    [first] = {text for text in running_agent.reporter.warnings if "refused" in text}
    assert f"no connection to mqtt://127.0.0.1:{mosquitto.port}: " in first


def test_tls_certificates_and_a_password(tmp_path: Path) -> None:
    """A wrong password is reported, and read again for each attempt."""
    authority = Authority(tmp_path)
    root = authority.make("root", AUTHORITY)
    server, client = authority.make("server", SERVER, "root"), authority.make("client", "", "root")
    passwords, password = tmp_path / "passwords", tmp_path / "password"
    subprocess.run(
        ["mosquitto_passwd", "-c", "-b", passwords, "robot", "right"], check=True, timeout=30
    )
    password.write_text("wrong\n")
    login = Login(
        user="robot",
        password_file=password,
        authorities=root,
        certificate=client,
        key=client.with_suffix(".key"),
    )
    lines = (
        f"cafile {root}",
        f"certfile {server}",
        f"keyfile {server.with_suffix('.key')}",
        "require_certificate true",
        f"password_file {passwords}",
        "allow_anonymous false",
    )
    with (
        running(tmp_path, *lines) as mosquitto,
        agent(mosquitto.port, login=login, tls=True, waiting=False) as running_agent,
    ):
        until(lambda: running_agent.reporter.warnings, "refusal", every=0.02)
        [warning] = running_agent.reporter.warnings
        assert warning.endswith(
            ': the broker refuses the user "robot": Not authorized; trying again'
        )
        trouble = warning.removesuffix("; trying again")
        assert running_agent.broker.trouble == trouble
        password.write_text("right\n")
        wait_until_ready(running_agent.broker, running_agent.reporter)
        assert running_agent.broker.trouble == ""
        context = login.make_context()
        with Peer(mosquitto.port, username="robot", password="right", context=context) as peer:
            peer.send(START, name(0))
        assert running_agent.wait_for(1) == names(1)


def test_topics_that_the_broker_refuses_are_reported(tmp_path: Path) -> None:
    """The agent is not ready without them."""
    [plugin] = Path("/usr/lib").glob("*/mosquitto_dynamic_security.so")
    access = {"publishClientSend": True, "publishClientReceive": True, "subscribe": False}
    group = {"groupname": "all", "roles": []}
    config = {"defaultACLAccess": access, "groups": [group], "anonymousGroup": "all"}
    (tmp_path / "access.json").write_text(json.dumps(config))
    lines = (f"plugin {plugin}", f"plugin_opt_config_file {tmp_path}/access.json")
    with (
        running(tmp_path, *lines) as mosquitto,
        agent(mosquitto.port, waiting=False) as running_agent,
    ):
        until(lambda: running_agent.reporter.warnings, "warning", every=0.02)
        assert f"refuses the topic {THING}/#: Not authorized" in running_agent.reporter.warnings[0]
        assert not running_agent.broker.is_ready


# paho-mqtt leaves it to the garbage collector to close a socket whose handshake failed.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("missing", ["authorities", "certificate"])
def test_a_connection_that_is_not_trusted_does_not_happen(tmp_path: Path, missing: str) -> None:
    """By the agent, whose machine does not know this authority, or by the broker."""
    authority = Authority(tmp_path)
    root, server = authority.make("root", AUTHORITY), authority.make("server", SERVER, "root")
    lines = (f"cafile {root}", f"certfile {server}", f"keyfile {server.with_suffix('.key')}")
    login = Login(authorities=root if missing == "certificate" else None)
    with (
        running(tmp_path, *lines, "require_certificate true") as mosquitto,
        agent(mosquitto.port, login=login, tls=True, waiting=False) as running_agent,
    ):
        until(lambda: running_agent.reporter.warnings, "warning", every=0.02)
        assert not running_agent.broker.is_ready


# As above.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_authority_is_read_again(tmp_path: Path) -> None:
    """Kubernetes changes the files of a Secret while the agent runs."""
    authority = Authority(tmp_path)
    root, server = authority.make("root", AUTHORITY), authority.make("server", SERVER, "root")
    trusted = tmp_path / "ca.crt"
    trusted.write_text(authority.make("other", AUTHORITY).read_text())
    lines = (f"certfile {server}", f"keyfile {server.with_suffix('.key')}")
    with (
        running(tmp_path, *lines) as mosquitto,
        agent(
            mosquitto.port, login=Login(authorities=trusted), tls=True, waiting=False
        ) as running_agent,
    ):
        until(lambda: running_agent.reporter.warnings, "refusal", every=0.02)
        assert "its certificate is not trusted: " in running_agent.reporter.warnings[0]
        trusted.write_text(root.read_text())
        wait_until_ready(running_agent.broker, running_agent.reporter)
        assert len(running_agent.reporter.warnings) == 1


def test_what_the_user_must_change_is_an_error_at_once(tmp_path: Path) -> None:
    login = Login(user="robot", password_file=tmp_path / "missing")
    with (
        pytest.raises(UserError, match="missing cannot be read for the broker's password"),
        connect(find_port(), Recorder(), login),
    ):
        pass

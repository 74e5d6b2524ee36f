"""The readiness probe for DDS against real participants."""

from __future__ import annotations

import signal

import pytest

from tests.support.until import until

pytestmark = pytest.mark.cluster

DDS = ("dds", "--domain", "0", "--interface", "net1")
AUTO = (
    "<CycloneDDS><Domain><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    "</Discovery></Domain></CycloneDDS>"
)
#: Has a participant's ports and never reads from them.
HANGING = """
import socket, time
kept = []
for port in (7400, 7410, 7411):
    kept.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    kept[-1].bind(("", port))
print("up", flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_ros(lab, distro):
    """A ROS 2 node is ready though nobody else is there, and stopped it is not."""
    pod = lab.ros("talker", "one", distro)
    done = pod.probe(*DDS)
    assert done.returncode == 0, done.stdout
    assert done.stdout.startswith("ready: process 1 (")
    pod.signal(signal.SIGSTOP)
    done = pod.probe(*DDS)
    assert done.returncode == 1
    assert done.stdout.endswith(" is stopped by a signal\n")
    pod.signal(signal.SIGCONT)
    assert pod.probe(*DDS).returncode == 0


@pytest.mark.parametrize("env", [{}, {"CYCLONEDDS_URI": AUTO}], ids=["none", "auto"])
def test_cyclone(lab, env):
    """A participant of Cyclone DDS is ready, with a port of its own choice and with a fixed one."""
    assert lab.cyclone("talker", "one", **env).probe(*DDS).returncode == 0


def test_nobody_is_waited_for(lab):
    """A node whose network leads nowhere is ready: readiness says nothing about others."""
    pod = lab.ros("talker", "one")
    pod.ip("route", "flush", "table", "main")
    assert pod.probe("dds", "--domain", "0").returncode == 0


def test_hanging(lab):
    """A process that has a participant's ports and reads nothing is told as hanging."""
    pod = lab.python("talker", "one", "dds", HANGING)
    done = pod.probe(*DDS)
    assert done.returncode == 1
    assert "hangs: what was sent to its UDP port 7410 was not read within 8 s" in done.stdout


def test_wrong_domain(lab):
    """A participant of another domain makes nothing ready, and its domain is told."""
    done = lab.ros("talker", "one", ROS_DOMAIN_ID="5").probe(*DDS)
    assert done.returncode == 1
    assert "takes part in DDS domain 5 instead of 0" in done.stdout


def test_any_domain(lab):
    """Where nobody told a domain, an image may have its own."""
    pod = lab.ros("talker", "one", ROS_DOMAIN_ID="5")
    done = pod.probe("dds")
    assert (done.returncode, done.stdout[-13:]) == (0, " at domain 5\n")
    idle = lab.start("idle", "one", "sleep", "600")
    assert idle.probe("dds").stdout == "no process of this container takes part in DDS yet\n"


def test_no_participant(lab):
    """A program without DDS is not ready; --wait ends when its time is over."""
    pod = lab.start("talker", "one", "sleep", "600")
    done = pod.probe(*DDS, "--wait", "1")
    assert done.returncode == 1
    assert done.stdout.startswith("no process of this container takes part in DDS domain 0 yet")


def test_interface(lab):
    """The second network's state is told: missing, without address, down."""
    pod = lab.ros("talker", "one")
    assert pod.probe("dds", "--domain", "0", "--interface", "net2").stdout.startswith(
        "net2 is missing: Multus did not attach"
    )
    pod.ip("link", "set", "net1", "down")
    assert pod.probe(*DDS).stdout == "net1 is down\n"
    pod.ip("link", "set", "net1", "up")
    assert pod.probe(*DDS).returncode == 0
    pod.ip("address", "flush", "dev", "net1")
    assert pod.probe(*DDS).stdout == "net1 has no IPv4 address, so DDS cannot use it\n"


def test_started_while_waiting(lab, tmp_path):
    """--wait sees a participant that comes later."""
    words = "import os, sys, time\nwhile not os.path.exists(sys.argv[2]): time.sleep(0.1)\n"
    words += "time.sleep(2); exec(sys.argv[1])"
    program = "from cyclonedds.domain import DomainParticipant as P; p = P(0); time.sleep(600)"
    python = str(lab.venv("dds") / "bin" / "python")
    begin = tmp_path / "begin"
    pod = lab.start("talker", "one", python, "-c", words, program, str(begin))
    assert pod.probe(*DDS).returncode == 1
    begin.touch()
    assert pod.probe(*DDS, "--wait", "120").returncode == 0


def test_discovery_server(lab):
    """A discovery server is probed by its port, its client by its own participant."""
    server = lab.discovery_server()
    assert server.probe("dds", "--port", "11811", "--wait", "120").returncode == 0
    assert server.probe("dds", "--port", "11812").returncode == 1
    where = f"{server.address}:11811"
    client = lab.ros("talker", "two", ROS_DISCOVERY_SERVER=where)
    assert client.probe(*DDS).returncode == 0
    server.signal(signal.SIGSTOP)
    assert server.probe("dds", "--port", "11811").returncode == 1
    assert client.probe(*DDS).returncode == 0


def test_zenoh(lab):
    """A zenoh session is ready while it is connected to a router."""
    router = lab.router("one")
    client = lab.zenoh("talker", "two", router)
    zenoh = ("zenoh", "--port", "7447")
    assert (
        client.probe(*zenoh).stdout == f"ready: connected to the zenoh router at {router.address}\n"
    )
    client.signal(signal.SIGSTOP)
    assert client.probe(*zenoh).returncode == 1
    client.signal(signal.SIGCONT)
    router.kill()

    def is_lost() -> bool:
        done = client.probe(*zenoh)
        return done.returncode == 1 and "is connected to a zenoh router yet" in done.stdout

    until(is_lost, "probe of a session without a router")


@pytest.mark.parametrize("words", ["dds --domain", "dds --domain x", "dds --what 1", "zenoh"])
def test_arguments(lab, words):
    """Wrong arguments have an exit code of their own."""
    pod = lab.start("talker", "one", "sleep", "600")
    assert pod.probe(*words.split()).returncode == 2

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


def test_wrong_domain(lab):
    """A participant of another domain makes nothing ready, and its domain is told."""
    done = lab.ros("talker", "one", ROS_DOMAIN_ID="5").probe(*DDS)
    assert done.returncode == 1
    assert "takes part in DDS domain 5 instead of 0" in done.stdout


def test_interface(lab):
    """The second network's state is told: missing, without address, down."""
    pod = lab.ros("talker", "one")
    assert pod.probe("dds", "--domain", "0", "--interface", "net2").stdout.startswith(
        "net2 is missing: Multus did not attach"
    )
    pod.ip("link", "set", "net1", "down")
    assert pod.probe(*DDS).stdout == "net1 is down\n"
    pod.ip("link", "set", "net1", "up")
    until(lambda: pod.probe(*DDS).returncode == 0, "interface that is up")  # Linux says so later
    pod.ip("address", "flush", "dev", "net1")
    assert pod.probe(*DDS).stdout == "net1 has no IPv4 address, so DDS cannot use it\n"


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

"""`rigel join`: a pod, a computer and a peer made of namespaces; real frames, no cluster."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, cast

import attrs
import pytest

import rigel_inpod
from rigel_k8s.app.development import make_pod
from rigel_k8s.commands.join import session
from rigel_k8s.commands.join.inside import read_variables
from rigel_k8s.commands.join.link import HEAD, Link
from rigel_k8s.commands.join.session import Session, find_deployment, remove_ended, running
from rigel_k8s.commands.pods import check_script
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.podnodes import note_nodes
from rigel_k8s.objects.pods import SCRIPTS_PATH, scripts_config
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder
from tests.support.until import until

RELAY = Path(rigel_inpod.__file__).parent / "join.py"
POD, PEER = "10.9.0.2", "10.9.0.1"
HARDWARE = "02:00:5e:00:53:01"

#: At the peer: a hash of what comes by TCP, an echo of datagrams, an answer to multicast.
ANSWERS = """
import hashlib, socket, struct, sys, threading
def stream():
    with socket.create_server(("", 7000)) as server:
        while True:
            with server.accept()[0] as one:
                data = b"".join(iter(lambda: one.recv(1 << 16), b""))
                one.sendall(hashlib.sha256(data).digest() + data)
def datagrams():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("10.9.0.1", 7000))
        while True:
            own.sendto(*own.recvfrom(65535))
threading.Thread(target=stream, daemon=True).start()
threading.Thread(target=datagrams, daemon=True).start()
own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
own.bind(("239.255.0.1", 7400))
there = socket.inet_aton("239.255.0.1") + socket.inet_aton("10.9.0.1")
own.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, there)
own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, there[4:])
own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
print("ready", flush=True)
while True:
    data, source = own.recvfrom(65535)
    own.sendto(b"heard " + data + b" from " + source[0].encode(), ("239.255.0.1", 7401))
"""
#: On the computer: all of that, as any program does it.
PROGRAM = """
import fcntl, hashlib, os, socket, sys
data = os.urandom(3_000_000)
with socket.create_connection(("peer.lab", 7000), 20) as one:
    one.sendall(data)
    one.shutdown(socket.SHUT_WR)
    back = b"".join(iter(lambda: one.recv(1 << 16), b""))
assert back == hashlib.sha256(data).digest() + data
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
    own.settimeout(20)
    own.sendto(data[:60_000], ("10.9.0.1", 7000))
    assert own.recvfrom(65535)[0] == data[:60_000]
with socket.create_connection(("10.99.0.1", 7000), 20) as one:  # behind the gateway
    one.shutdown(socket.SHUT_WR)
    assert one.recv(1 << 16) == hashlib.sha256(b"").digest()
own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
assert fcntl.ioctl(own, 0x8927, b"eth0".ljust(40, b"\\0"))[18:24].hex(":") == sys.argv[1]
own.bind(("239.255.0.1", 7401))
there = socket.inet_aton("239.255.0.1") + socket.inet_aton("10.9.0.2")
own.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, there)
own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, there[4:])
own.settimeout(20)
own.sendto(b"hello", ("239.255.0.1", 7400))
assert own.recvfrom(65535)[0] == b"heard hello from 10.9.0.2"
assert os.environ["ROS_DOMAIN_ID"] == "7" and "ROS_IP" not in os.environ
"""


@attrs.frozen
class Lab:
    """The namespaces of a pod and of its peer, named by processes in them."""

    pod: int
    peer: int

    def run(self, place: int, *words: str) -> None:
        """Run a command in a namespace."""
        subprocess.run([*self.enter(place), *words], check=True)

    def enter(self, place: int) -> list[str]:
        """Return the words before a command in a namespace."""
        return ["nsenter", f"--target={place}", "--net", "--mount"]

    def exec(
        self,
        _namespace: str,
        _pod: str,
        _line: list[str],
        *,
        stdin: BinaryIO,
        stdout: BinaryIO,
        stderr: BinaryIO,
        container: str,
    ) -> int:
        """Run the relay, as a cluster does."""
        environ = {"ROS_DOMAIN_ID": "7", "HOME": "/nowhere", "PATH": os.environ["PATH"]}
        line = [*self.enter(self.pod), sys.executable, str(RELAY)]
        with subprocess.Popen(line, stdin=stdin, stdout=subprocess.PIPE, env=environ) as relay:
            assert relay.stdout
            while data := os.read(relay.stdout.fileno(), 1 << 16):
                stdout.write(data)
        return relay.wait()


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    """A pod with an interface and its peer at the other end."""
    if os.geteuid() != 0 or not shutil.which("ip"):
        pytest.skip("namespaces need root and iproute2")
    made = [
        subprocess.Popen(["unshare", "--net", "--mount", "sleep", "1000"], start_new_session=True)
        for _ in range(2)
    ]
    ours = Path("/proc/self/ns/net").readlink()
    for one in made:
        place = Path(f"/proc/{one.pid}/ns/net")
        until(lambda place=place: place.readlink() != ours, "namespace", 20)
    found = Lab(*(one.pid for one in made))
    veth = ["type", "veth", "peer", "name", "eth0", "netns", str(found.peer)]
    found.run(found.pod, "ip", "link", "add", "eth0", "mtu", "1400", *veth)
    for place, address in ((found.pod, POD), (found.peer, PEER)):
        found.run(place, "ip", "link", "set", "lo", "up")
        found.run(place, "ip", "address", "add", f"{address}/24", "dev", "eth0")
        found.run(place, "ip", "link", "set", "eth0", "up", "mtu", "1400")
    found.run(found.pod, "ip", "route", "add", "default", "via", PEER)
    found.run(found.pod, "ip", "link", "set", "eth0", "address", HARDWARE)
    found.run(found.peer, "ip", "address", "add", "10.99.0.1/32", "dev", "lo")
    hosts = tmp_path / "hosts"
    hosts.write_text(f"127.0.0.1 localhost\n{PEER} peer.lab\n")
    found.run(found.pod, "mount", "--bind", str(hosts), "/etc/hosts")
    yield found
    for one in made:
        os.killpg(one.pid, signal.SIGKILL)
        one.wait()


@pytest.fixture
def signals() -> Iterator[None]:
    """What a session leaves as it found it, since a process has one session."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.programs
def test_a_program_here_is_an_ordinary_participant(
    lab: Lab, signals: None, capfd: pytest.CaptureFixture[str]
) -> None:
    """Large streams, datagrams in fragments, multicast and names, with the pod's address."""
    report = Recorder()
    with subprocess.Popen(
        [*lab.enter(lab.peer), sys.executable, "-c", ANSWERS], stdout=subprocess.PIPE
    ) as peer:
        assert peer.stdout
        assert peer.stdout.readline() == b"ready\n"
        try:
            session = Session(cast(Any, lab), ObjectRef("v1", "Pod", "n", "join-1"), report)
            assert session.run([sys.executable, "-c", PROGRAM, HARDWARE]) == 0, capfd.readouterr()
        finally:
            peer.kill()
    assert report.lines == [f"joined as {POD} (eth0)"]
    until(session.over.is_set, "end of the relay", 20)


@pytest.mark.programs
def test_the_program_is_ended_when_the_pod_goes(lab: Lab, signals: None, tmp_path: Path) -> None:
    """With an error; its exit code is not that of a program that ended by itself."""
    session = Session(cast(Any, lab), ObjectRef("v1", "Pod", "n", "join-1"), Recorder())
    runs = tmp_path / "runs"

    def end_the_relay() -> None:
        until(runs.exists, "program")
        subprocess.run(["pkill", "-KILL", "-f", str(RELAY)], check=True)

    ending = threading.Thread(target=end_the_relay)
    ending.start()
    with pytest.raises(ClusterError, match="the connection to the pod has ended"):
        session.run(["sh", "-c", f"touch {runs}; exec sleep 1000"])
    ending.join()


@pytest.mark.programs
@pytest.mark.parametrize(
    ("command", "code"), [(["sh", "-c", "exit 7"], 7), (["sh", "-c", "kill -TERM $$"], 143)]
)
def test_the_exit_code_is_the_programs(
    lab: Lab, signals: None, command: list[str], code: int
) -> None:
    session = Session(cast(Any, lab), ObjectRef("v1", "Pod", "n", "join-1"), Recorder())
    assert session.run(command) == code


def test_frames_come_in_any_parts() -> None:
    """What a websocket delivers has nothing to do with the frames."""
    link = Link()
    ends = [os.pipe(), os.pipe()]
    frames = [(0, b"a" * 100), (1, b"b"), (0, b"c" * 1500)]
    whole = b'{"interfaces": []}\n'
    link.write(whole[:5])
    assert not link.begun.is_set()
    link.write(whole[5:])
    assert link.network == {"interfaces": []}
    sent = b"".join(HEAD.pack(number, len(data)) + data for number, data in frames)
    link.give_to([into for _, into in ends])
    for place in range(0, len(sent), 7):
        link.write(sent[place : place + 7])
    assert os.read(ends[0][0], 1 << 16) == b"a" * 100 + b"c" * 1500
    assert os.read(ends[1][0], 1 << 16) == b"b"
    for number in (*ends[0], *ends[1], link.stdin):
        os.close(number)
    link.end()


def test_files_are_where_the_variables_say(tmp_path: Path) -> None:
    """ROS 1 has the pod's address as its own."""
    network = {
        "folder": "/rigel-k8s-network",
        "files": {"dds.xml": "see /rigel-k8s-network/more.xml"},
        "variables": {
            "CYCLONEDDS_URI": "file:///rigel-k8s-network/dds.xml",
            "ROS_MASTER_URI": "http://ros-master:11311",
        },
        "interfaces": [{"address": "10.1.2.3"}],
    }
    assert read_variables(network, tmp_path) == {
        "CYCLONEDDS_URI": f"file://{tmp_path}/dds.xml",
        "ROS_MASTER_URI": "http://ros-master:11311",
        "ROS_IP": "10.1.2.3",
    }
    assert (tmp_path / "dds.xml").read_text() == f"see {tmp_path}/more.xml"


def deployment(**spec: Any) -> dict[str, Any]:
    """Return a Deployment of a node with a claim, a probe, and a second network."""
    node = {
        "name": "ros-node",
        "image": "lab/arm@sha256:1",
        "args": ["ros2", "run"],
        "env": [{"name": "ROS_MASTER_URI", "value": "http://ros-master:11310"}],
        "readinessProbe": {"exec": {}},
        "resources": {"limits": {"nvidia.com/gpu": 1}},
        "volumeMounts": [
            {"name": "rigel-inpod", "mountPath": "/rigel-k8s"},
            {"name": "data", "mountPath": "/data"},
        ],
    }
    network = {
        "name": "rigel-network",
        "volumeMounts": [
            {"name": "rigel-network-source", "mountPath": "/source"},
            {"name": "rigel-network", "mountPath": "/rigel-k8s-network"},
        ],
    }
    other = {"name": "fetch", "volumeMounts": [{"name": "data", "mountPath": "/data"}]}
    pod = {
        "containers": [node],
        "initContainers": [network, other],
        "volumes": [{"name": "rigel-inpod"}, {"name": "data"}, {"name": "rigel-network"}],
        "dnsPolicy": "ClusterFirst",
        "nodeName": "robot",
        **spec,
    }
    meta = {
        "labels": {"rigel-k8s/release": "lab", "app.kubernetes.io/name": "arm"},
        "annotations": {"k8s.v1.cni.cncf.io/networks": "net1", "rigel-k8s/node": "arm"},
    }
    return {
        "metadata": {"name": "arm", "namespace": "n"},
        "spec": {"template": {"metadata": meta, "spec": pod}},
    }


def test_the_pod_stands_in_the_network_and_does_nothing_else() -> None:
    """No claim, no device, no probe; of the first containers only the one for the network."""
    made = make_pod(deployment(), "join-1", by="me")
    assert made["metadata"]["labels"] == {
        "rigel-k8s/release": "lab",
        "app.kubernetes.io/name": "rigel-join",
    }
    assert made["metadata"]["annotations"] == {
        "k8s.v1.cni.cncf.io/networks": "net1",
        "rigel-k8s/joined": "me",
    }
    spec = made["spec"]
    (container,) = spec["containers"]
    assert container["env"] == [{"name": "ROS_MASTER_URI", "value": "http://ros-master:11311"}]
    assert [one["name"] for one in spec["initContainers"]] == ["rigel-network"]
    assert [one["name"] for one in spec["volumes"]] == ["rigel-inpod", "rigel-network"]
    assert [one["name"] for one in container["volumeMounts"]] == ["rigel-inpod"]
    assert "limits" not in container["resources"]
    assert "nodeName" not in spec


def test_the_network_of_a_machine_cannot_be_joined() -> None:
    with pytest.raises(UserError, match="network: host"):
        make_pod(deployment(hostNetwork=True), "join-1", by="me")


def test_a_node_without_a_ros_name_is_found(fake: FakeCluster) -> None:
    """Those of a Compose file are anonymous; that the machines have its network is said then."""
    labels = {"rigel-k8s/release": "lab", "app.kubernetes.io/name": "arm"}
    live = {"apiVersion": "apps/v1", "kind": "Deployment", **deployment(hostNetwork=True)}
    live["metadata"]["name"] = "arm"
    container = live["spec"]["template"]["spec"]["containers"][0]
    container["volumeMounts"][0]["mountPath"] = SCRIPTS_PATH
    fake.create(live)
    spec = live["spec"]["template"]["spec"]
    meta = {"name": "arm-1", "namespace": "n", "labels": labels}
    fake.create({"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": spec})
    found = find_deployment(Release(cast(Any, fake), ReleaseId("n", "lab")), None)
    with pytest.raises(UserError, match="network: host"):
        make_pod(found, "join-1", by="me")


def joined(name: str = "rigel-join-1") -> dict[str, Any]:
    """Return the pod of a computer."""
    return make_pod(deployment(), name, by="me")


def set_status(fake: FakeCluster, name: str, **status: Any) -> None:
    """Let a pod have a status, and keep it."""
    fake.store.controllers = None
    fake.store.objects[ObjectRef("v1", "Pod", "n", name)]["status"] = status


def test_no_command_takes_the_pod_for_one_of_the_release(fake: FakeCluster) -> None:
    """No node is in it: `status`, `logs` and `graph` have nothing to say of it."""
    fake.create(joined())
    plain = joined("arm-1")
    del plain["metadata"]["annotations"]
    fake.create(plain)
    found = list_pods(cast(Any, fake), ReleaseId("n", "lab"))
    assert [one["metadata"]["name"] for one in found] == ["arm-1"]


def test_a_node_that_shares_its_pod_is_not_replaced(
    fake: FakeCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other nodes of the pod would stop, too; nothing is written."""
    config = {"apiVersion": "v1", "kind": "ConfigMap", "data": {"join.py": ""}}
    fake.create({**config, "metadata": {"name": scripts_config("lab"), "namespace": "n"}})
    labels = {"rigel-k8s/release": "lab", "app.kubernetes.io/name": "arms"}
    notes = note_nodes({"arm": {"rigel-k8s/node": "arm"}, "hand": {"rigel-k8s/node": "hand"}})
    meta = {"name": "arms-1", "namespace": "n", "labels": labels, "annotations": notes}
    spec = deployment()["spec"]["template"]["spec"]
    fake.create({"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": spec})
    deploying = {"apiVersion": "apps/v1", "kind": "Deployment", **deployment()}
    deploying["metadata"]["name"] = "arms"
    fake.create(deploying)
    before = list(fake.writes)
    monkeypatch.setattr(session, "check_computer", lambda: None)
    found = Release(cast(Any, fake), ReleaseId("n", "lab"))
    monkeypatch.setattr(session, "release", lambda *_: found)
    settings = Settings(Path("Rigelfile"))
    with pytest.raises(UserError, match="arm shares its pod with other nodes"):
        session.join(settings, ["true"], Recorder(), replaced="arm")
    assert fake.writes == before


def test_what_a_computer_has_left_behind_is_removed(fake: FakeCluster) -> None:
    """Another computer's pod, which runs, stays."""
    for name, phase in (("join-1", "Succeeded"), ("join-2", "Running"), ("join-3", "Failed")):
        fake.create(joined(name))
        set_status(fake, name, phase=phase)
    remove_ended(Release(cast(Any, fake), ReleaseId("n", "lab")))
    assert fake.names("Pod") == {"join-2"}


def test_a_pod_that_does_not_run_is_named_with_the_cause(fake: FakeCluster) -> None:
    """And is gone afterwards."""
    waiting = {"reason": "ImagePullBackOff", "message": "no such image"}
    state = {"name": "rigel-join", "image": "lab/arm", "state": {"waiting": waiting}}
    create = fake.create

    def create_waiting(manifest: dict[str, Any]) -> None:
        create(manifest)
        set_status(fake, "rigel-join-1", phase="Pending", containerStatuses=[state])

    cluster = SimpleNamespace(create=create_waiting, get=fake.get, delete=fake.delete)
    with (
        pytest.raises(ClusterError, match="does not run after 0 s") as caught,
        running(cast(Any, cluster), joined(), 0.0, Recorder()),
    ):
        pytest.fail("it runs")
    assert "no such image" in caught.value.details[0]
    assert fake.names("Pod") == set()


def test_the_scripts_of_an_older_version_are_not_enough(fake: FakeCluster) -> None:
    """A release without the script has to be deployed again first."""
    found = Release(cast(Any, fake), ReleaseId("n", "lab"))
    with pytest.raises(UserError, match="lab was deployed by an older rigel-k8s") as caught:
        check_script(found, "join.py", "joined")
    assert "rigel run" in str(caught.value.hint)
    config = {"apiVersion": "v1", "kind": "ConfigMap", "data": {"join.py": ""}}
    fake.create({**config, "metadata": {"name": scripts_config("lab"), "namespace": "n"}})
    check_script(found, "join.py", "joined")

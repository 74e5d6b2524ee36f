"""The exporter as Prometheus sees it: text, configuration, and a scrape that never waits."""

from __future__ import annotations

import json
import re
import socket
import struct
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from rigel_exporter import messages
from rigel_exporter.collection import Collection, Server
from rigel_exporter.config import Config, ConfigFailed, read
from rigel_exporter.graph import Graph, Node
from rigel_exporter.listening import STALE, STATUSES, Listening
from rigel_exporter.metrics import FAMILIES, MOST_OF_A_LABEL, Sample, text
from rigel_exporter.samples import Samples, Subscription
from tests.support.until import until


def text_of(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def status(name: str, level: int) -> bytes:
    """A DiagnosticArray of one status, in ROS 1's serialization."""
    words = [name, "", "hw"]
    own = bytes([level]) + b"".join(map(text_of, words)) + struct.pack("<I", 0)
    return struct.pack("<IIII", 0, 0, 0, 0) + struct.pack("<I", 1) + own


def transform(stamp: int) -> bytes:
    """A TFMessage of one transform."""
    header = struct.pack("<III", 0, stamp, 0) + text_of("map")
    return struct.pack("<I", 1) + header + text_of("base") + bytes(56)


class Heard(Subscription):
    """A topic that somebody else fills."""

    def __init__(self, topic: str) -> None:
        super().__init__(topic, 0, lambda _: None)
        self.now = Samples()

    def samples(self) -> Samples:
        found, self.now = self.now, self.now._replace(payloads=())
        return found


class Half:
    """A graph of one node, whose look waits as long as it is told."""

    counts = False

    def __init__(self) -> None:
        self.heard: dict[str, Heard] = {}
        self.go = threading.Event()
        self.fails = False

    def look(self) -> Graph:
        assert self.go.wait(30)
        if self.fails:
            raise RuntimeError("a look that went wrong")
        return Graph(nodes=[Node("/talker", up=True, registered=True)])

    def subscribe(self, topic: str, keep: int = 0) -> Heard:
        self.heard[topic] = Heard(topic)
        return self.heard[topic]

    def read(self, payload: bytes) -> messages.Reader:
        return messages.ros1(payload)

    def close(self) -> None:
        """Nothing to leave."""


def told(listening: Listening, name: str, now: float) -> dict[tuple[str, ...], float]:
    found = [s for s in listening.samples(now) if s.name == name]
    return {tuple(s.labels.values()): s.value for s in found}


def test_text_is_prometheus_and_escapes_what_must_be() -> None:
    made = text([Sample("ros_node_up", 1.0, {"ros_node": 'a"b\\c\nd'}), Sample("ros_master_up", 0)])
    assert 'ros_node_up{ros_node="a\\"b\\\\c\\nd"} 1\n' in made
    assert made.index("# TYPE ros_master_up gauge") < made.index("ros_master_up{} 0")
    assert "# TYPE ros_node_up gauge\nros_node_up{" in made
    assert "ros_topic" not in made


def test_counters_are_named_as_counters() -> None:
    for name, (kind, meaning) in FAMILIES.items():
        assert (kind == "counter") == name.endswith("_total"), name
        assert meaning.endswith(".")


def test_only_what_is_named_or_asked_for_is_subscribed() -> None:
    half = Half()
    Listening(half, Config(topics=["/a"], clock=True))
    assert set(half.heard) == {"/a", "/clock"}
    nothing = Half()
    Listening(nothing, Config())
    assert nothing.heard == {}


def test_a_named_topic_is_told_from_the_start_and_its_header_by_its_delay() -> None:
    half = Half()
    listening = Listening(half, Config(topics=["/a"]))
    assert told(listening, "ros_topic_messages_total", 0.0) == {("/a",): 0}
    assert told(listening, "ros_topic_last_message_timestamp_seconds", 0.0) == {}
    half.heard["/a"].now = Samples(3, 30, last=100.0, stamp=99.5)
    assert told(listening, "ros_topic_bytes_total", 500.0) == {("/a",): 30}
    assert told(listening, "ros_topic_header_age_seconds", 500.0) == {("/a",): 0.5}


def test_levels_turn_stale_and_are_bounded() -> None:
    half = Half()
    listening = Listening(half, Config(diagnostics=True))
    many = tuple(status(f"s{i:04}", 1) for i in range(STATUSES + 3))
    half.heard["/diagnostics"].now = Samples(payloads=many)
    levels = told(listening, "ros_diagnostics_level", 0.0)
    assert len(levels) == STATUSES
    assert set(levels.values()) == {1}
    assert told(listening, "ros_exporter_dropped", 0.0) == {("diagnostics",): 3}
    half.heard["/diagnostics"].now = Samples(payloads=(status("s0000", 2),))
    listening.refresh(STALE)
    later = told(listening, "ros_diagnostics_level", STALE + 1)
    assert later[("s0000", "hw")] == 2
    assert later[("s0001", "hw")] == 3


def test_transforms_are_as_old_as_the_ros_clock_says() -> None:
    half = Half()
    listening = Listening(half, Config(tf=True, clock=True))
    half.heard["/tf"].now = Samples(payloads=(transform(40),))
    assert told(listening, "ros_tf_age_seconds", 1000.0) == {("map", "base"): 960}
    half.heard["/clock"].now = Samples(last=990.0, payloads=(struct.pack("<II", 42, 500_000_000),))
    assert told(listening, "ros_clock_age_seconds", 1000.0) == {(): 10}
    assert told(listening, "ros_tf_age_seconds", 1000.0) == {("map", "base"): 2.5}


def test_a_message_that_is_none_is_counted_and_harms_nothing() -> None:
    half = Half()
    listening = Listening(half, Config(clock=True))
    half.heard["/clock"].now = Samples(last=1.0, payloads=(b"no",))
    listening.refresh(1.0)
    assert listening.unreadable == 1


@pytest.fixture
def served() -> Iterator[tuple[Half, Collection, str]]:
    half = Half()
    collection = Collection(half, Config(interval=0.05))
    server = Server(0, collection.metrics, collection.well)
    collection.start()
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield half, collection, f"http://127.0.0.1:{server.server_address[1]}"
    half.go.set()
    collection.close()
    server.shutdown()
    server.server_close()


def get(url: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(url, timeout=20) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_who_waits_no_longer_leaves_no_traceback(capfd: pytest.CaptureFixture[str]) -> None:
    """A kubelet's probe on a busy machine ends its connection while it is answered."""
    asked, gone = threading.Event(), threading.Event()

    def metrics() -> str:
        asked.set()
        assert gone.wait(20)
        return "x" * 10_000_000

    server = Server(0, metrics, lambda: True)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    before = threading.active_count()
    with socket.create_connection(("127.0.0.1", server.server_address[1])) as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        client.sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
        assert asked.wait(20)
    gone.set()
    until(lambda: threading.active_count() <= before, "end of threads", 60, every=0.02)
    server.shutdown()
    server.server_close()
    assert capfd.readouterr().err == ""


def test_a_scrape_waits_for_no_look(served: tuple[Half, Collection, str]) -> None:
    """The first look has not ended: metrics are there, and the exporter is not well yet."""
    half, _, url = served
    status, body = get(f"{url}/metrics")
    assert status == 200
    assert "ros_exporter_info" in body
    assert "ros_node_up" not in body
    assert get(f"{url}/healthz")[0] == 503
    half.go.set()
    until(lambda: get(f"{url}/healthz") == (200, "ok\n"), "health", 60, every=0.02)
    assert 'ros_node_up{ros_node="/talker",workload=""} 1' in get(f"{url}/metrics")[1]
    assert get(f"{url}/")[0] == 404


def test_a_look_that_fails_is_counted_and_the_next_one_made(
    served: tuple[Half, Collection, str], capsys: pytest.CaptureFixture[str]
) -> None:
    half, _, url = served
    half.fails = True
    half.go.set()

    def failures() -> int:
        found = re.search(r"ros_exporter_failures_total\{\} (\d+)", get(f"{url}/metrics")[1])
        return int(found[1]) if found else 0

    until(lambda: failures() >= 2, "second failure", 60, every=0.02)
    half.fails = False
    until(lambda: get(f"{url}/healthz")[0] == 200, "health", 60, every=0.02)
    assert "a look that went wrong" in capsys.readouterr().err


def test_a_configuration_is_read_with_its_defaults(tmp_path: Path) -> None:
    file = tmp_path / "config.json"
    file.write_text(json.dumps({"ros": "2", "expected": {"/a": "a"}, "topics": ["/x"], "tf": True}))
    found = read(file)
    assert (found.ros, found.expected, found.topics, found.tf) == ("2", {"/a": "a"}, ["/x"], True)
    assert found.interval == 10.0
    assert found.port == 9419


@pytest.mark.parametrize(
    ("told", "word"),
    [("{", "config.json: "), ("[7]", "config.json: "), ('{"tpoics": []}', "unknown field tpoics")],
)
def test_a_configuration_of_another_version_is_refused(
    tmp_path: Path, told: str, word: str
) -> None:
    file = tmp_path / "config.json"
    file.write_text(told)
    with pytest.raises(ConfigFailed, match=word):
        read(file)


def test_the_first_look_waits_until_the_others_are_known() -> None:
    """A participant that has just joined a domain knows nobody, and nobody is gone."""
    half = Half()
    half.go.set()
    collection = Collection(half, Config(expected={"/talker": "t"}), after=3600.0)
    collection.start()
    assert not collection.well()
    assert "ros_node_up" not in collection.metrics()
    collection.close()


def test_a_long_name_is_shortened_and_stays_its_own() -> None:
    """Prometheus refuses a scrape with longer ones, and two series of one name."""
    names = [f"/{'x' * 20_000}{number}" for number in range(2)]
    found = text(Sample("ros_clock_age_seconds", 1, {"topic": name}) for name in [*names, "/short"])
    labels = re.findall(r'topic="([^"]*)"', found)
    assert len(set(labels)) == 3
    assert max(map(len, labels)) == MOST_OF_A_LABEL
    assert labels[0].startswith("/xxx")
    assert labels[2] == "/short"

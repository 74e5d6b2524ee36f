"""The DDS half without a network: conversations of real participants are played back to it.

packets/NAME.hex: the prefix that was the exporter's, then what it was sent, a message a line.
"""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from rigel_exporter import dds_discovery as discovery
from rigel_exporter import dds_participant
from rigel_exporter import dds_wire as wire
from rigel_exporter import messages as messages_of
from rigel_exporter.dds import Domain
from rigel_exporter.dds_discovery import ENDPOINTS
from rigel_exporter.dds_participant import NAME, Participant
from rigel_exporter.dds_view import graph
from rigel_exporter.graph import Graph
from rigel_inpod import rtps, spdp
from rigel_inpod.spdp import Announcement

PACKETS = Path(__file__).parent / "packets"
HERE = ("10.9.0.9", 7410)
RECORDED = ["fastdds-2.14", "fastdds-3.2", "cyclonedds-11"]


def recorded(name):
    """(the exporter's prefix, the messages)."""
    own, *messages = [bytes.fromhex(line) for line in (PACKETS / f"{name}.hex").read_text().split()]
    return own, messages


class Wire:
    """Keeps what a participant sends."""

    def __init__(self):
        self.sent = []

    def __call__(self, message, places):
        self.sent += [(message, place) for place in places]

    def items(self, own):
        """(whom it was sent to, submessage) of all."""
        for message, place in self.sent:
            to = next((bytes(b) for k, _, b in rtps.submessages(message) if k == 0x0E), b"")
            yield from ((to, place, item) for _, item in wire.read(memoryview(message), to or own))


def participant(prefix=b"p" * 12, domain=0):
    told = Announcement(
        prefix, domain=domain, name=NAME, lease=20, endpoints=ENDPOINTS, meta=(HERE,)
    )
    sent = Wire()
    return Participant(told, sent), sent


def play(own, messages, now=0.0):
    for message in messages:
        own.take(memoryview(message), "10.9.0.3", now, 1000.0 + now)


def seen(own):
    return graph(own.peers.values(), own.writers, own.readers)


def alive(messages):
    """How many of the messages came while the talker ran: up to its last sample."""
    return max(n for n, message in enumerate(messages) if b"x" * 20 in message) + 1


@pytest.mark.parametrize("name", RECORDED[:2])
def test_ros_node(name):
    """A conversation with rclpy gives its node, its topics, the named one's samples, its end."""
    prefix, messages = recorded(name)
    own, _ = participant(prefix)
    hearing = own.hear("/chatter", 1, own.leave)
    end = alive(messages)
    play(own, messages[:end])
    heard, found = hearing.samples(), seen(own)
    assert [node[:4] for node in found.nodes] == [("/robot/talker", True, True, "10.9.0.3")]
    assert {topic.name: topic[1:] for topic in found.topics} == {
        "/chatter": ("std_msgs/msg/String", 1, 0),
        "/rosout": ("rcl_interfaces/msg/Log", 1, 0),
        "/parameter_events": ("rcl_interfaces/msg/ParameterEvent", 1, 0),
    }
    assert (heard.messages, heard.size, heard.last) == (3, 3 * 32, 1000.0)
    assert [len(payload) for payload in heard.payloads] == [32]
    assert hearing.samples().payloads == (), "handed out once"
    play(own, messages[end:])
    assert seen(own) == Graph(nodes=[], topics=[])
    assert not own.writers
    assert not own.readers


def test_other_dds():
    """A conversation with Cyclone DDS, whose topics have keys of none and a header's stamp."""
    prefix, messages = recorded("cyclonedds-11")
    own, _ = participant(prefix)
    hearing = own.hear("/tf", 1, own.leave)
    play(own, messages)
    assert [node.name for node in seen(own).nodes] == ["python"]
    assert {topic.name for topic in seen(own).topics} == {"/diagnostics", "/tf", "plain"}
    heard = hearing.samples()
    assert (heard.messages > 0, heard.stamp) == (True, 100.5)
    [payload] = heard.payloads
    assert messages_of.transforms(messages_of.cdr(payload)) == [
        ("map", "odom", 100.5),
        ("map", "base", 100.5),
    ]


@pytest.mark.parametrize("name", RECORDED)
def test_only_what_is_named_is_subscribed_to(name):
    """Readers are announced for ros_discovery_info and the named topic, and for nothing else."""
    prefix, messages = recorded(name)
    own, sent = participant(prefix)
    own.hear("/tf", 0, own.leave)
    play(own, messages)
    samples = [
        item
        for _, _, item in sent.items(prefix)
        if isinstance(item, wire.Data) and item.writer == discovery.SUBSCRIPTIONS_WRITER
    ]
    told = {discovery.endpoint(item.payload).topic for item in samples}
    assert told == ({"rt/tf"} if name == "cyclonedds-11" else {"ros_discovery_info"})


def test_closed_subscriber_takes_its_reader_back():
    """Who closes a subscriber hears nothing more, and tells everybody that its reader is gone."""
    prefix, messages = recorded("fastdds-2.14")
    own, sent = participant(prefix)
    hearing = own.hear("/chatter", 0, own.leave)
    first = next(n for n, message in enumerate(messages) if b"x" * 20 in message) + 1
    play(own, messages[:first])
    sent.sent.clear()
    own.leave(hearing)
    [gone] = [i for _, _, i in sent.items(prefix) if isinstance(i, wire.Data)]
    assert (gone.status, gone.key[:12]) == (3, prefix)
    play(own, messages[first : alive(messages)])
    assert hearing.samples().messages == 1


def test_two_hear_one_topic():
    """A topic that is heard twice is announced once, and stays so until nobody hears it."""
    prefix, messages = recorded("fastdds-2.14")
    own, sent = participant(prefix)
    one, two = own.hear("/chatter", 0, own.leave), own.hear("/chatter", 0, own.leave)
    end = alive(messages)
    play(own, messages[:end])
    assert one.samples().messages == two.samples().messages == 3
    sent.sent.clear()
    own.leave(one)
    assert sent.sent == []
    own.leave(two)
    assert sent.sent != []


def test_silence():
    """Who is silent is asked, counts as not answering after three questions, and then expires."""
    prefix, messages = recorded("fastdds-2.14")
    own, sent = participant(prefix)
    end = alive(messages)
    play(own, messages[:end])
    sent.sent.clear()
    up = []
    for now in range(1, 21):
        own.tick(float(now))
        up.append([node.up for node in seen(own).nodes])
    assert up == [[True]] * 7 + [[False]] * 13
    asked = [i for _, _, i in sent.items(prefix) if isinstance(i, wire.Heartbeat) and not i.final]
    assert len(asked) == 10
    assert {item.writer for item in asked} == {discovery.SUBSCRIPTIONS_WRITER}
    play(own, messages[end - 1 : end], now=20.0)
    assert [node.up for node in seen(own).nodes] == [True]
    own.tick(41.0)
    assert seen(own) == Graph(nodes=[], topics=[])


def test_nobody_is_blamed_for_our_own_sleep():
    """An exporter that got no processor for a minute tells nobody dead before it has asked."""
    prefix, messages = recorded("fastdds-2.14")
    own, _ = participant(prefix)
    end = alive(messages)
    play(own, messages[:end])
    own.tick(19.0)
    assert [node.up for node in seen(own).nodes] == [True]


def test_heartbeats_are_answered():
    """What is missing is asked for; what is there is acknowledged, so that it is not sent again."""
    prefix, messages = recorded("fastdds-2.14")
    own, sent = participant(prefix)
    play(own, messages)
    acknowledged = {}
    for _, _, item in sent.items(prefix):
        if isinstance(item, wire.Acknack):
            acknowledged[item.writer] = max(acknowledged.get(item.writer, 0), item.base)
    assert acknowledged[discovery.PUBLICATIONS_WRITER] > 5
    assert acknowledged[discovery.SUBSCRIPTIONS_WRITER] > 5


def test_other_domain_is_left_alone():
    """A participant that says it is in another domain is none of ours."""
    _, messages = recorded("fastdds-3.2")
    own, sent = participant(domain=7)
    play(own, messages)
    assert not own.peers
    assert not sent.sent


def test_our_own_are_in_nobodys_count():
    """Two exporters in one domain do not count each other."""
    one, _ = participant(b"1" * 12)
    two, _ = participant(b"2" * 12)
    play(two, [one.announcement()])
    assert two.peers
    assert seen(two) == Graph(nodes=[], topics=[])


def test_a_discovery_server_is_no_node():
    own, _ = participant()
    properties = (("PARTICIPANT_TYPE", "SERVER"),)
    told = Announcement(b"s" * 12, domain=0, meta=(HERE,), properties=properties)
    play(own, [spdp.announcement(told)])
    assert own.peers
    assert seen(own) == Graph(nodes=[], topics=[])


def test_broken_packets_never_end_the_loop():
    """Whatever comes is read, or is Malformed, which the loop ignores; nothing else is raised."""
    chance = random.Random(5)
    for name in RECORDED:
        prefix, messages = recorded(name)
        for _ in range(40):
            own, _ = participant(prefix)
            own.hear("/chatter", 2, own.leave)
            own.hear("/tf", 2, own.leave)
            for message in messages:
                feed(own, spoiled(chance, message))
            own.tick(3.0)
            seen(own)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_ended_thread_is_told(monkeypatch):
    """What was known is not told for ever: where nobody listens any more, a look fails."""
    monkeypatch.setattr(Domain, "_open", lambda self: 1 / 0)
    domain = Domain(interface="lo")
    assert domain.look() == Graph(nodes=[], topics=[])
    domain.start()
    domain._thread.join(30)
    with pytest.raises(RuntimeError, match="has ended"):
        domain.look()


def spoiled(chance, message):
    raw = bytearray(message)
    for _ in range(chance.choice([0, 0, 1, 1, 3, 20])):
        raw[chance.randrange(len(raw))] = chance.choice([0, 1, 0x16, 0x7F, 0x80, 0xFF])
    return bytes(raw[: chance.choice([len(raw), len(raw), chance.randrange(len(raw))])])


def feed(own, message):
    try:
        own.take(memoryview(message), "10.9.0.3", 1.0, 1.0)
    except rtps.Malformed:
        return


def announced(number, domain=0):
    prefix = number.to_bytes(12, "big")
    told = Announcement(prefix, domain=domain, meta=(("10.9.0.7", 7000),), lease=1e6)
    return spdp.announcement(told)


def test_strangers_keep_no_participant_away(monkeypatch):
    """Those that have announced only themselves make room, the oldest first; the others stay."""
    monkeypatch.setattr(dds_participant, "_MOST_PEERS", 20)
    prefix, messages = recorded("fastdds-2.14")
    own, _ = participant(prefix)
    play(own, messages[: alive(messages)])
    before = [node.name for node in seen(own).nodes if node.name]
    assert before
    play(own, [announced(number) for number in range(1, 100)])
    assert [node.name for node in seen(own).nodes if node.name][: len(before)] == before
    assert len(own.peers) == 20
    late = announced(100)
    play(own, [late])
    assert (100).to_bytes(12, "big") in own.peers
    assert (1).to_bytes(12, "big") not in own.peers


def test_a_table_full_of_participants_with_endpoints_takes_no_more(monkeypatch):
    """They are what the exporter shows."""
    monkeypatch.setattr(dds_participant, "_MOST_PEERS", 3)
    own, _ = participant()
    play(own, [announced(number) for number in range(1, 4)])
    for peer in own.peers.values():
        peer.has_endpoints = True
    play(own, [announced(4)])
    assert (4).to_bytes(12, "big") not in own.peers

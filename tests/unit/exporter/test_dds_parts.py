"""The parts of the DDS half: submessages, reliability, CDR, names."""

from __future__ import annotations

from struct import pack

import pytest

from rigel_exporter import dds_discovery as discovery
from rigel_exporter import dds_wire as wire
from rigel_exporter import messages
from rigel_exporter.dds_names import is_service, topic_name, type_name
from rigel_exporter.dds_reliable import Incoming, Outgoing, Source
from rigel_exporter.samples import Subscription
from rigel_inpod import rtps, spdp

READER, WRITER = b"\x00\x00\x01\x04", b"\x00\x00\x01\x03"
OWN, OTHER = b"o" * 12, b"t" * 12


def read(*submessages, to=OWN):
    message = wire.message(OTHER, rtps.UNKNOWN, to, submessages)
    return [item for _, item in wire.read(memoryview(message), OWN)]


def sample(number, payload=b"\x00\x01\x00\x00data"):
    return wire.Data(WRITER, number, memoryview(payload))


def heartbeat(first, last):
    return wire.Heartbeat(WRITER, first, last, False)


def fragment(number, first, total=1000, size=300, count=1, payload=None):
    begin = (first - 1) * size
    whole = b"\x00\x01\x00\x00" + bytes(i % 251 for i in range(total - 4))
    part = whole[begin : begin + count * size] if payload is None else payload
    return wire.Fragment(WRITER, number, first, size, total, memoryview(part))


def test_what_is_written_is_read():
    """ACKNACK, HEARTBEAT and GAP are read as they were written, with sets of numbers."""
    missing = (7, 9, 7 + 31, 7 + 32, 7 + 200)
    found = read(
        wire.acknack(READER, WRITER, 7, missing, 1, final=False),
        wire.heartbeat(READER, WRITER, 3, 1 << 40, 2, final=True),
        wire.gap(READER, WRITER, 5, 8),
    )
    assert found == [
        wire.Acknack(READER, WRITER, 7, missing),
        wire.Heartbeat(WRITER, 3, 1 << 40, True),
        wire.Gap(WRITER, 5, 8, ()),
    ]


def test_for_others():
    """What is addressed to another participant is not read."""
    assert read(wire.gap(READER, WRITER, 5, 8), to=b"x" * 12) == []


def test_big_endian_fragment():
    """A DATA_FRAG of a big-endian writer is read; one without a size is Malformed."""
    body = pack(">HH", 0, 28) + READER + WRITER + pack(">iIIHHI", 0, 4, 2, 1, 300, 1000) + b"abc"
    raw = rtps.header(OTHER, rtps.UNKNOWN) + pack(">BBH", 0x16, 0, len(body)) + body
    [(source, item)] = wire.read(memoryview(raw), OWN)
    assert (source, item) == (OTHER, wire.Fragment(WRITER, 4, 2, 300, 1000, memoryview(b"abc")))
    broken = raw.replace(pack(">HHI", 1, 300, 1000), pack(">HHI", 1, 0, 1000))
    with pytest.raises(rtps.Malformed):
        list(wire.read(memoryview(broken), OWN))


def test_samples_come_in_order_and_once():
    """A sample waits for those before it, which are asked for; a gap ends the waiting."""
    incoming = Incoming(READER)
    assert incoming.take(sample(3)) == [], "nobody knows yet what there was before"
    assert incoming.heartbeat(heartbeat(1, 4)) == []
    assert incoming.list_missing() == [1, 2, 4]
    [ack] = read(incoming.answer(WRITER))
    assert ack == wire.Acknack(READER, WRITER, 1, (1, 2, 4))
    assert len(incoming.take(sample(1))) == 1
    assert len(incoming.gap(wire.Gap(WRITER, 2, 3, ()))) == 1
    assert incoming.take(sample(3)) == []
    assert len(incoming.take(sample(4))) == 1
    [ack] = read(incoming.answer(WRITER))
    assert (ack.base, ack.missing) == (5, ())


def test_nobody_waits_for_what_a_writer_forgot():
    """What is before a heartbeat's first sample is not waited for."""
    incoming = Incoming(READER)
    incoming.take(sample(9))
    assert len(incoming.heartbeat(heartbeat(9, 9))) == 1


def test_writer_that_starts_anew():
    """A writer under its old GUID that counts from one again is followed."""
    incoming = Incoming(READER)
    incoming.heartbeat(heartbeat(1, 5))
    for number in range(1, 6):
        incoming.take(sample(number))
    incoming.heartbeat(heartbeat(1, 2))
    assert incoming.list_missing() == [1, 2]
    assert len(incoming.take(sample(1))) == 1


def test_latest_is_held_back():
    """Where it is a sign of life, the latest sample is never acknowledged, nor asked for again."""
    incoming = Incoming(READER, holds_back=True)
    incoming.heartbeat(heartbeat(4, 4))
    incoming.take(sample(4))
    [ack] = read(incoming.answer(WRITER))
    assert (ack.base, ack.missing) == (4, ())


def test_reliable_fragments():
    """A reliable sample is put together from fragments in any order, and lost ones asked for."""
    incoming = Incoming(READER)
    incoming.heartbeat(heartbeat(1, 1))
    assert incoming.take(fragment(1, 3, count=2)) == []
    assert incoming.take(fragment(1, 1)) == []
    assert incoming.list_missing() == [1]
    [change] = incoming.take(fragment(1, 2))
    assert change.payload == bytes(fragment(1, 1, count=4).payload)


def test_own_writer_gives_what_is_asked_for():
    """Asked for a sample it gives it, for one it took back it gives a gap."""
    outgoing = Outgoing(WRITER, READER)
    outgoing.add(b"", b"one")
    outgoing.add(b"", b"two")
    outgoing.drop(1)
    found = read(*outgoing.answer(wire.Acknack(READER, WRITER, 1, (1, 2, 3))))
    assert found == [wire.Gap(WRITER, 1, 2, ()), wire.Data(WRITER, 2, memoryview(b"two"))]
    [beat] = read(outgoing.beat())
    assert (beat.first, beat.last, beat.final) == (2, 2, False)


def test_large_samples_count_once():
    """A sample in fragments counts with its first one, by its whole size, though some get lost."""
    hearing = Subscription("/image", 1, lambda hearing: None)
    source = Source(hearing, "sensor_msgs/msg/Image")
    for part in (fragment(1, 2), fragment(1, 3, count=2), fragment(2, 1, count=4)):
        source.take(part, 5.0)
    source.take(fragment(1, 1), 6.0)  # late
    heard = hearing.samples()
    assert (heard.messages, heard.size, heard.last) == (2, 2000, 5.0)
    assert heard.payloads == (bytes(fragment(2, 1, count=4).payload),)


def test_sample_twice():
    """A sample that comes twice, on two ways, counts once."""
    hearing = Subscription("/chatter", 0, lambda hearing: None)
    source = Source(hearing, "std_msgs/msg/String")
    for number in (1, 1, 2, 1):
        source.take(sample(number), 5.0)
    assert hearing.samples().messages == 2


@pytest.mark.parametrize("order", "<>")
def test_stamp(order):
    """A header's stamp is read in either byte order, and of a list's first element."""
    kind = b"\x00\x01\x00\x00" if order == "<" else b"\x00\x00\x00\x00"
    stamp = pack(order + "iI", 12, 250_000_000)
    assert messages.stamp(kind + stamp, "sensor_msgs/msg/Imu") == 12.25
    assert messages.stamp(kind + stamp, "geometry_msgs/msg/PoseStamped") == 12.25
    assert messages.stamp(kind + pack(order + "I", 1) + stamp, "tf2_msgs/msg/TFMessage") == 12.25
    assert messages.stamp(kind + pack(order + "I", 0), "tf2_msgs/msg/TFMessage") is None
    assert messages.stamp(kind + stamp, "std_msgs/msg/String") is None
    assert messages.cdr(kind + stamp).time() == 12.25


def test_xcdr2():
    """A payload in XCDR 2 with its size in front gives its stamp too."""
    payload = b"\x00\x09\x00\x00" + pack("<I", 8) + pack("<iI", 12, 0)
    assert messages.stamp(payload, "sensor_msgs/msg/Imu") == 12.0


@pytest.mark.parametrize("gid", [16, 24])
def test_nodes(gid):
    """A participant's nodes and their endpoints, with the GUIDs of humble and of later ones."""
    names = [("/robot", "talker"), ("/", "b")]
    raw = b"\x00\x01\x00\x00" + b"g" * gid + pack("<I", len(names))
    for namespace, name in names:
        for text in (namespace, name):
            raw += b"\0" * (-(len(raw) - 4) % 4) + pack("<I", len(text) + 1) + text.encode() + b"\0"
        raw += b"\0" * (-(len(raw) - 4) % 4)
        raw += pack("<I", 1) + b"r" * gid + pack("<I", 2) + b"w" * gid * 2
    guids = frozenset([b"r" * 16, b"w" * 16])
    assert messages.nodes(raw) == {"/robot/talker": guids, "/b": guids}
    with pytest.raises(messages.Unreadable):
        messages.nodes(raw[:-5])


@pytest.mark.parametrize("size", range(0, 60, 4))
def test_cut_payloads(size):
    """A payload that ends too early is Unreadable, whatever it is read as."""
    whole = b"\x00\x01\x00\x00" + pack("<I", 3) * 20
    for read_as in (messages.diagnostics, messages.transforms):
        with pytest.raises(messages.Unreadable):
            read_as(messages.cdr(whole[:size]))
    with pytest.raises(messages.Unreadable):
        messages.nodes(whole[:size])


def test_names():
    """Names as `ros2 topic list -t` shows them; others stay as they are."""
    assert topic_name("rt/robot/chatter") == "/robot/chatter"
    assert topic_name("Square") == "Square"
    assert type_name("std_msgs::msg::dds_::String_") == "std_msgs/msg/String"
    assert type_name("a::B") == "a::B"
    assert [is_service(name) for name in ("rq/xRequest", "rr/xReply", "rt/rq")] == [
        True,
        True,
        False,
    ]


def test_partition_is_repeated():
    """Or its reader is not matched; a big-endian writer's is not, since we write little-endian."""
    value = pack("<I", 1) + spdp.text("east")
    pairs = [(discovery.PID_ENDPOINT, OTHER + WRITER), (discovery.PID_PARTITION, value)]
    assert discovery.endpoint(rtps.serialized(pairs)).quality == ((discovery.PID_PARTITION, value),)


@pytest.mark.parametrize("pid", ["PID_TOPIC", "PID_TYPE", "PID_PARTITION"])
def test_a_name_that_dds_does_not_allow_is_not_kept(pid):
    """50,000 endpoints with 30 KB each would fill any memory."""
    pairs = [
        (discovery.PID_ENDPOINT, OTHER + WRITER),
        (getattr(discovery, pid), spdp.text(30_000 * "x")),
    ]
    with pytest.raises(rtps.Malformed):
        discovery.endpoint(rtps.serialized(pairs))


def test_what_a_participant_says_of_itself_is_read_up_to_a_limit():
    """The same for 2,000 participants."""
    long = 60_000 * "x"
    pairs = (("name", "x"),) * 2000
    told = spdp.Announcement(b"p" * 12, name=long, properties=pairs)
    found = spdp.participant(memoryview(spdp.payload_of(told)))
    assert len(found.name) == spdp.LONGEST
    assert len(found.properties) == spdp.MOST_PROPERTIES

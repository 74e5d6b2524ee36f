"""ROS 1's messages, connection headers and counts, by their bytes."""

from __future__ import annotations

import struct

import pytest

from rigel_exporter import messages
from rigel_exporter.ros1_topic import decode_header, encode_header
from rigel_exporter.ros1_traffic import Ledger, count_growth


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def header(seconds: int, nanoseconds: int = 0, frame: str = "map") -> bytes:
    return struct.pack("<III", 1, seconds, nanoseconds) + text(frame)


def test_a_header_is_known_by_the_definitions_first_field() -> None:
    assert messages.has_header("# a comment\n\nint32 X=3\nHeader header\nint8 a")
    assert messages.has_header("std_msgs/Header header # the time")
    assert not messages.has_header("string data\n====\nMSG: std_msgs/Header\nuint32 seq")
    assert not messages.has_header("int32 A=1\n====\nMSG: x/Y\nHeader header")
    assert not messages.has_header("")


def test_diagnostics_are_read_to_the_last_status() -> None:
    pairs = struct.pack("<I", 1) + text("key") + text("value")
    status = bytes([1]) + text("left") + text("warm") + text("m1") + pairs
    other = bytes([2]) + text("right") + text("") + text("") + struct.pack("<I", 0)
    payload = header(1) + struct.pack("<I", 2) + status + other
    assert messages.diagnostics(messages.ros1(payload)) == [("left", "m1", 1), ("right", "", 2)]


def test_transforms_and_the_clock_are_read() -> None:
    one = header(9, frame="map") + text("base") + bytes(56)
    payload = struct.pack("<I", 2) + one + one
    assert messages.transforms(messages.ros1(payload)) == [("map", "base", 9.0)] * 2
    assert messages.ros1(struct.pack("<II", 3, 250_000_000)).time() == 3.25


@pytest.mark.parametrize("read", [messages.diagnostics, messages.transforms])
def test_what_is_cut_off_is_no_message(read) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(messages.Unreadable):
        read(messages.ros1(header(1) + struct.pack("<I", 1)))


def test_connection_headers_go_there_and_back() -> None:
    fields = {"callerid": "/me", "md5sum": "*", "message_definition": "a=1\nb"}
    assert decode_header(encode_header(fields)[4:]) == fields
    with pytest.raises(ValueError, match="TCPROS"):
        decode_header(struct.pack("<I", 3) + b"abc")


def test_a_counter_goes_on_around_32_bits_and_after_a_restart() -> None:
    assert count_growth(5, 8) == 3
    assert count_growth(2**31 - 1, -(2**31)) == 1
    assert count_growth(1000, 10) == 10


def test_both_client_libraries_counts_are_read() -> None:
    """rospy: [topic, size, [[id, bytes, messages, connected]]]; roscpp has one number more."""
    ledger = Ledger()
    rospy = [["/a", "90", [["1", "110", "9", "1"], ["2", "50", "4", "1"]]]]
    roscpp = [["/b", [["1", "200", "180", "20", "0"]]]]
    received = [["/c", [["3", "70", "7", "-1", "1"], ["4", "30", "3", "-1", "1"]]]]
    ledger.add("/n", "http://n:1/", [rospy + roscpp, received, []])
    assert {(t.topic, t.direction, t.messages, t.size) for t in ledger.totals()} == {
        ("/a", "published", 9, 160),
        ("/b", "published", 20, 180),
        ("/c", "received", 10, 100),
    }


def test_counts_never_go_back_when_a_connection_ends_or_the_node_starts_again() -> None:
    ledger = Ledger()

    def total(uri: str, connections: list[list[str]]) -> int:
        ledger.add("/n", uri, [[], [["/c", connections]], []])
        return ledger.totals()[0].messages

    assert total("http://n:1/", [["1", "10", "5"], ["2", "10", "5"]]) == 10
    assert total("http://n:1/", [["2", "12", "6"]]) == 11
    assert total("http://n:2/", [["2", "4", "2"]]) == 13
    ledger.keep([])
    assert ledger.totals() == []


def test_an_answer_that_is_no_statistics_counts_nothing() -> None:
    ledger = Ledger()
    for odd in ([], [[], [], []], "no", [[["/a"]], [["/b", []]]]):
        ledger.add("/n", "http://n:1/", odd)
    assert all(t.messages == t.size == 0 for t in ledger.totals())

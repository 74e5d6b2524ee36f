"""The RTPS encoding against packets that real participants sent (captured; packets/*.hex)."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from rigel_inpod import rtps, spdp
from tests.support.ddspeer import announced

PACKETS = Path(__file__).parent / "packets"
PREFIX = bytes(range(1, 13))


def packet(name: str) -> bytes:
    return bytes.fromhex("".join((PACKETS / f"{name}.hex").read_text().split()))


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            "fastdds-2.14",
            {
                "prefix": "010f3d11e76c0b2600000000",
                "vendor": "Fast DDS",
                "domain": None,
                "name": "/",
                "user_data": "enclave=/;",
                "locators": [("10.9.0.1", 7410)],
                "lease": 20,
            },
        ),
        (
            "fastdds-3.2",
            {
                "prefix": "010f3d110d06124d00000000",
                "vendor": "Fast DDS",
                "domain": 0,
                "name": "/",
                "user_data": "enclave=/;",
                "locators": [("10.9.0.1", 7410)],
                "lease": 20,
            },
        ),
        (
            "cyclonedds-11",
            {
                "prefix": "0110af0c0bb3ec2f138acbea",
                "vendor": "Cyclone DDS",
                "domain": 0,
                "name": "",
                "user_data": "",
                "locators": [("10.9.0.3", 42170)],
                "lease": 10,
            },
        ),
        (
            "rustdds-0.15",
            {
                "prefix": "01122736b2128d84edf30918",
                "vendor": "RustDDS",
                "domain": None,
                "name": "",
                "user_data": "",
                "locators": [("10.9.0.1", 7410)],
                "lease": 50,
            },
        ),
    ],
)
def test_real_announcements(name: str, told: dict[str, object]):
    """What real participants announce is read: who, whose, which domain, where to answer."""
    [(found, leaves)] = announced(packet(name))
    assert {
        "prefix": found.prefix.hex(),
        "vendor": rtps.VENDORS[int.from_bytes(found.vendor, "big")],
        "domain": found.domain,
        "name": found.name,
        "user_data": found.user_data,
        "locators": list(found.meta),
        "lease": found.lease,
    } == told
    assert not leaves


@pytest.mark.parametrize(
    ("name", "prefix"),
    [
        ("fastdds-3.2-leaving", "010f3d110d06124d00000000"),
        ("cyclonedds-11-leaving", "0110c315bd653a3ea42f49fc"),
    ],
)
def test_real_farewells(name: str, prefix: str):
    """A participant that takes its announcement back is leaving, not announced."""
    [(found, leaves)] = announced(packet(name))
    assert (found.prefix.hex(), leaves) == (prefix, True)


@pytest.mark.parametrize("path", sorted(PACKETS.glob("*.hex")), ids=lambda path: path.stem)
def test_broken_packets(path: Path):
    """However a packet is cut or spoilt, it is read or it is malformed; nothing else happens."""
    whole = packet(path.stem)
    spoilt = [whole[:end] for end in range(len(whole))]
    spoilt += [whole[:i] + bytes([v]) + whole[i + 1 :] for i in range(len(whole)) for v in (0, 255)]
    refused = 0
    for message in spoilt:
        try:
            announced(message)
        except (rtps.Malformed, struct.error, IndexError):
            refused += 1
    assert 0 < refused < len(spoilt)


def test_announcement():
    """What is announced is read again as it was told."""
    told = spdp.Announcement(
        PREFIX,
        b"\x01\x10",
        domain=7,
        name="graph",
        properties=(("PARTICIPANT_TYPE", "CLIENT"), ("a", "")),
        meta=(("10.1.2.3", 4567), ("10.1.2.4", 1)),
        data=(("10.1.2.3", 4568),),
        lease=5.0,
        endpoints=3,
    )
    assert announced(spdp.announcement(told)) == [(told, False)]


def test_farewell():
    """Ours is one that the same reader understands."""
    [(found, leaves)] = announced(spdp.farewell(PREFIX))
    assert (found.prefix, leaves) == (PREFIX, True)


def test_a_farewell_without_a_payload():
    """The key hash tells who leaves, where there is nothing else."""
    inline = rtps.parameters([(rtps.PID_KEY_HASH, PREFIX + b"abcd"), (rtps.PID_STATUS, rtps.GONE)])
    data = rtps.data(rtps.SPDP_READER, rtps.SPDP_WRITER, 2, inline, b"", is_key=True)
    [(found, leaves)] = announced(rtps.header(bytes(12), rtps.UNKNOWN) + data)
    assert (found.prefix, leaves) == (PREFIX, True)


def test_for_a_discovery_server():
    """A discovery server is asked as Fast DDS asks: its vendor, the sample's identity inline."""
    message = spdp.announcement(
        spdp.Announcement(PREFIX, rtps.FAST_DDS, meta=(("10.1.2.3", 4567),))
    )
    assert message[6:8] == rtps.FAST_DDS
    assert struct.pack("<HH", 0x800F, 24) + PREFIX + rtps.SPDP_WRITER in message
    assert announced(message)[0][0].prefix == PREFIX
    plain = spdp.announcement(spdp.Announcement(PREFIX, rtps.UNKNOWN))
    assert struct.pack("<HH", 0x800F, 24) not in plain


def test_a_sample_is_read_as_it_was_written():
    """Its number goes beyond 32 bits."""
    number = (5 << 32) + 7
    message = rtps.header(PREFIX, rtps.UNKNOWN)
    message += rtps.data(b"read", b"writ", number, b"", b"\0\1\0\0payload ")
    [(_, flags, body)] = rtps.submessages(message)
    assert rtps.read_data(body, flags) == (b"writ", number, b"\0\1\0\0payload ", 0, b"")


def test_beacon():
    """A beacon is a submessage of a vendor's own, which participants must ignore (8.3.4.1)."""
    message = rtps.beacon(PREFIX)
    assert message[:4] == b"RTPS"
    assert message[20] >= 0x80
    assert announced(message) == []


@pytest.mark.parametrize(
    ("domain", "announcements", "first"), [(0, 7400, 7410), (1, 7650, 7660), (232, 65400, 65410)]
)
def test_ports(domain: int, announcements: int, first: int):
    """Ports are where the standard puts them (9.6.1.1)."""
    assert rtps.announcement_port(domain) == announcements
    assert rtps.participant_port(domain, 0) == first
    assert rtps.domain_of(announcements) == rtps.domain_of(first) == domain
    assert rtps.domain_of(7000) is None

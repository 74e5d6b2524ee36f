"""The RTPS encoding against packets that real participants sent (captured; packets/*.hex)."""

from __future__ import annotations

import importlib.util
import struct
import sys
from pathlib import Path
from types import ModuleType

import pytest

import rigel_k8s.inpod

PACKETS = Path(__file__).parent / "packets"
PREFIX = bytes(range(1, 13))


def packet(name: str) -> bytes:
    return bytes.fromhex("".join((PACKETS / f"{name}.hex").read_text().split()))


@pytest.fixture(scope="module")
def rtps() -> ModuleType:
    """The script as a module, as its neighbours in the pod import it."""
    path = Path(rigel_k8s.inpod.__file__).parent / "rtps.py"
    spec = importlib.util.spec_from_file_location("rtps", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
def test_real_announcements(rtps: ModuleType, name: str, told: dict[str, object]):
    """What real participants announce is read: who, whose, which domain, where to answer."""
    assert rtps.announced(packet(name)) == [{**told, "leaving": False}]


@pytest.mark.parametrize(
    ("name", "prefix"),
    [
        ("fastdds-3.2-leaving", "010f3d110d06124d00000000"),
        ("cyclonedds-11-leaving", "0110c315bd653a3ea42f49fc"),
    ],
)
def test_real_farewells(rtps: ModuleType, name: str, prefix: str):
    """A participant that takes its announcement back is leaving, not announced."""
    (found,) = rtps.announced(packet(name))
    assert (found["prefix"], found["leaving"]) == (prefix, True)


@pytest.mark.parametrize("path", sorted(PACKETS.glob("*.hex")), ids=lambda path: path.stem)
def test_broken_packets(rtps: ModuleType, path: Path):
    """However a packet is cut or spoilt, it is read or it is malformed; nothing else happens."""
    whole = packet(path.stem)
    spoilt = [whole[:end] for end in range(len(whole))]
    spoilt += [whole[:i] + bytes([v]) + whole[i + 1 :] for i in range(len(whole)) for v in (0, 255)]
    refused = 0
    for message in spoilt:
        try:
            rtps.announced(message)
            rtps.beacon_text(message)
            rtps.addressee(message)
        except rtps.Malformed:
            refused += 1
    assert 0 < refused < len(spoilt)


def test_announcement(rtps: ModuleType):
    """Ours says what it was given, and matches nothing but other announcements."""
    message = rtps.announcement(PREFIX, 7, "graph", "10.1.2.3", 4567, 5)
    (found,) = rtps.announced(message)
    assert found == {
        "prefix": PREFIX.hex(),
        "vendor": "vendor 0000",
        "domain": 7,
        "name": "graph",
        "user_data": "",
        "locators": [("10.1.2.3", 4567)],
        "lease": 5,
        "leaving": False,
    }
    endpoints = struct.pack("<HHI", 0x0058, 4, 0x03)
    assert endpoints in message


def test_farewell(rtps: ModuleType):
    """Ours is one that the same reader understands."""
    (found,) = rtps.announced(rtps.farewell(PREFIX))
    assert (found["prefix"], found["leaving"]) == (PREFIX.hex(), True)


def test_for_a_discovery_server(rtps: ModuleType):
    """A discovery server is asked as Fast DDS asks: its vendor, the sample's identity inline."""
    message = rtps.announcement(PREFIX, 0, "graph", "10.1.2.3", 4567, 5, rtps.FAST_DDS)
    assert message[6:8] == rtps.FAST_DDS
    assert struct.pack("<HH", 0x800F, 24) + PREFIX + rtps.SPDP_WRITER in message
    assert rtps.announced(message)[0]["prefix"] == PREFIX.hex()


def test_beacon(rtps: ModuleType):
    """A beacon is a submessage of a vendor's own, which participants must ignore (8.3.4.1)."""
    message = rtps.beacon(PREFIX, "talker-1")
    assert message[:4] == b"RTPS"
    assert message[20] >= 0x80
    assert rtps.beacon_text(message) == "talker-1"
    assert rtps.announced(message) == []
    assert rtps.beacon_text(packet("fastdds-2.14")) is None


@pytest.mark.parametrize(
    ("domain", "announcements", "first"), [(0, 7400, 7410), (1, 7650, 7660), (232, 65400, 65410)]
)
def test_ports(rtps: ModuleType, domain: int, announcements: int, first: int):
    """Ports are where the standard puts them (9.6.1.1)."""
    assert rtps.announcement_port(domain) == announcements
    assert rtps.participant_port(domain, 0) == first
    assert rtps.domain_of(announcements) == rtps.domain_of(first) == domain
    assert rtps.domain_of(7000) is None


def test_module_is_not_kept():
    """The tests above load the script by its path: no module of that name hides another's."""
    assert "rtps" not in sys.modules

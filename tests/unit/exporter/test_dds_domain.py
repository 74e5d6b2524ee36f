"""The exporter in a DDS domain of real sockets on the loopback."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from rigel_exporter import dds_ways
from rigel_exporter.dds import Domain
from rigel_inpod import rtps
from tests.support.ddspeer import peer, some_domain
from tests.support.until import until

DOMAIN = some_domain()


@contextmanager
def joined(**more: object) -> Iterator[Domain]:
    domain = Domain(DOMAIN, interface="lo", mode="peers", peers=["127.0.0.1"], **more)  # type: ignore[arg-type]
    domain.start()
    try:
        yield domain
    finally:
        domain.close()


def test_a_peer_is_asked_told_of_and_forgotten() -> None:
    """Who answers is in the graph until it leaves; who listens hears of our own end."""
    with peer(DOMAIN) as other:
        with joined() as domain:

            def names() -> list[str]:
                return [node.name for node in domain.look().nodes]

            other.until(lambda: names() == ["other"], "the peer is in the graph")
            [node] = domain.look().nodes
            assert (node.up, node.registered, node.address) == (True, True, "127.0.0.1")
            other.leave(other.heard[0][0])
            # Not answering meanwhile: it would be back before it is seen to be gone.
            until(lambda: names() == [], "the peer is forgotten", 60, every=0.02)
            other.until(lambda: names() == ["other"], "it is asked again and comes back")
        other.until(lambda: any(leaves for _, leaves in other.heard), "our farewell")
    prefixes = {told.prefix for told, _ in other.heard}
    assert len(prefixes) == 1
    assert all(told.domain == DOMAIN for told, leaves in other.heard if not leaves)


def test_a_packet_of_another_program_does_no_harm() -> None:
    with peer(DOMAIN) as other, joined() as domain:
        other.until(lambda: other.heard, "we are asked")
        place = other.heard[0][0].meta[0]
        for broken in (b"", b"RTPS", os.urandom(200), b"RTPS" + os.urandom(200)):
            other.socket.sendto(broken, place)
        other.until(lambda: domain.look().nodes, "the peer is in the graph all the same")


def test_who_listens_no_more_says_so() -> None:
    """What was known before would be told for ever."""
    with joined() as domain:
        domain.look()
    with pytest.raises(RuntimeError, match="has ended"):
        domain.look()


def test_the_loopback_is_used_where_there_is_nothing_else() -> None:
    assert dds_ways.addresses("lo") == {"lo": "127.0.0.1"}
    assert dds_ways.addresses("nothing0") == {}


def test_with_other_interfaces_the_loopback_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    known = {"lo": "127.0.0.1", "net1": "10.0.0.1", "down0": None}
    monkeypatch.setattr(dds_ways, "address_of", known.get)
    monkeypatch.setattr(socket, "if_nameindex", lambda: list(enumerate(known, 1)))
    assert dds_ways.addresses(None) == {"net1": "10.0.0.1"}
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo")])
    assert dds_ways.addresses(None) == {"lo": "127.0.0.1"}


def test_the_group_is_joined_on_its_interface() -> None:
    """What is announced by multicast comes to the exporter."""
    sockets = dds_ways.Sockets(DOMAIN, {"lo": "127.0.0.1"}, is_multicast=True)
    try:
        sockets.send(b"to all", [(rtps.GROUP, rtps.announcement_port(DOMAIN))])
        buffer = bytearray(100)
        heard = [bytes(buffer[:size]) for size, _ in sockets.receive(buffer, 5)]
    finally:
        sockets.close()
    assert heard == [b"to all"]


def test_names_are_resolved_beside_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is unknown keeps no other waiting, and what was known stays."""
    resolver = dds_ways.Resolver(["localhost", "nobody.invalid"])
    try:
        until(lambda: resolver.found, "address", every=0.01)
        assert resolver.found == {"localhost": "127.0.0.1"}
    finally:
        resolver.close()

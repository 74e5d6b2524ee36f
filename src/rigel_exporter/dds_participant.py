"""A participant of a DDS domain that reads discovery and subscribes to the named topics.

Why: only the participants have the domain's graph; a participant that joins their discovery gets
all of it. It announces a reader for ros_discovery_info, as every tool of ROS 2 does, one for each
named topic and type, and nothing else, so it gets nothing else.

It must not use sockets, threads or a clock: messages and times are passed in.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Protocol

from rigel_exporter import dds_discovery as discovery
from rigel_exporter import dds_names as names
from rigel_exporter import dds_wire as wire
from rigel_exporter import messages
from rigel_exporter.dds_discovery import Endpoint
from rigel_exporter.dds_peer import SERVER, Peer
from rigel_exporter.dds_reliable import Change, Incoming, Outgoing, Source
from rigel_exporter.samples import Subscription
from rigel_inpod import rtps, spdp
from rigel_inpod.spdp import Announcement, Place

NAME = "rigel-k8s exporter"  # what a tool that lists participants shows
LEASE = 20  # seconds; then others forget us, even if our farewell is lost
_MOST_PEERS, _MOST_ENDPOINTS, _MOST_READERS = 2000, 50_000, 1000
_NO_KEY, _KEY = b"\x04", b"\x07"  # kinds of readers


class Send(Protocol):
    """Sends a message to some places."""

    def __call__(self, message: bytes, places: Sequence[Place]) -> None:
        """Send it to each of them."""


class Participant:
    """Our participant.

    Attributes:
        peers: the others, by their prefixes.
        writers, readers: their endpoints by GUID, without the built-in ones.
        servers: where discovery servers are; set from outside.
    """

    def __init__(self, own: Announcement, send: Send) -> None:
        self.own, self._send = own, send
        self.peers: dict[bytes, Peer] = {}
        self.writers: dict[bytes, Endpoint] = {}
        self.readers: dict[bytes, Endpoint] = {}
        self._outgoing = Outgoing(discovery.SUBSCRIPTIONS_WRITER, discovery.SUBSCRIPTIONS_READER)
        self._own_readers: dict[Endpoint, int] = {}
        self._subscriptions: list[Subscription] = []
        self.servers: Sequence[Place] = ()
        self._sources: dict[bytes, list[Source]] = {}
        self._ids, self._beats = itertools.count(1), 0

    # What we send

    def announcement(self) -> bytes:
        """Return the message that announces us."""
        return bytes(spdp.announcement(self.own))

    @property
    def _is_client(self) -> bool:
        """Whether we are a discovery server's client; it only accepts Fast DDS' vendor id."""
        return self.own.vendor == rtps.FAST_DDS

    def _inline(self, writer: bytes, number: int, *pairs: tuple[int, bytes]) -> bytes:
        """Return a sample's inline QoS; a server only passes on samples with their identity."""
        related = rtps.identity(self.own.prefix, writer, number) if self._is_client else []
        return bytes(rtps.parameters([*pairs, *related]))

    def farewell(self) -> bytes:
        """Return the message that announces our end."""
        return bytes(spdp.farewell(self.own.prefix, self.own.vendor))

    def tick(self, now: float) -> None:
        """Forget expired participants, ping silent ones; about once a second."""
        for peer in [peer for peer in self.peers.values() if peer.is_expired(now)]:
            self._forget(peer.announced.prefix)
        for peer in self.peers.values():
            if peer.is_to_be_asked(now) or peer.is_behind:
                peer.is_behind = False
                self._ask(peer)
            for writer, incoming in peer.incoming.items():
                if not incoming.is_known:
                    self._answer_writer(peer, writer, incoming.answer(writer, final=False))

    def _ask(self, peer: Peer) -> None:
        """Ask a participant for an answer."""
        if peer.is_direct:
            self._send_to(peer, [self._outgoing.beat()])
            return
        for writer, incoming in peer.incoming.items():
            self._answer_writer(peer, writer, incoming.answer(writer, final=False))

    def _send_to(self, peer: Peer, submessages: Sequence[bytes]) -> None:
        own, to = self.own, peer.announced.prefix
        self._send(wire.message(own.prefix, own.vendor, to, submessages), peer.places)

    # What we receive

    def take(self, message: memoryview, source: str, now: float, wall: float) -> None:
        """Take in a message.

        Args:
            message: the message.
            source: the sender's address.
            now: seconds of a monotonic clock.
            wall: seconds since 1970.

        Raises:
            rtps.Malformed: it, or the rest of it, is not RTPS.
        """
        for prefix, item in wire.read(message, self.own.prefix):
            if prefix == self.own.prefix:
                return
            peer = self.peers.get(prefix)
            if peer:
                peer.hear(now)
            if isinstance(item, (wire.Data, wire.Fragment)):
                sources = self._sources.get(prefix + item.writer)
                if sources:
                    for known in sources:
                        known.take(item, wall)
                elif peer and item.writer in peer.incoming:
                    changes = peer.incoming[item.writer].take(item)
                    self._apply(prefix + item.writer, changes, now)
                elif item.writer == rtps.SPDP_WRITER and isinstance(item, wire.Data):
                    change = Change(bytes(item.payload), item.status, item.key)
                    self._take_announcement(prefix, change, source, now)
            elif peer:
                self._take_protocol(peer, item, now)
            elif self._is_client and item.writer == rtps.SPDP_WRITER:
                self._greet(prefix, now)

    def _take_protocol(
        self, peer: Peer, item: wire.Heartbeat | wire.Gap | wire.Acknack, now: float
    ) -> None:
        if isinstance(item, wire.Acknack):
            self._take_acknack(peer, item)
            return
        incoming = peer.incoming.get(item.writer)
        if incoming is None:
            return
        guid = peer.announced.prefix + item.writer
        if isinstance(item, wire.Gap):
            self._apply(guid, incoming.gap(item), now)
            return
        self._apply(guid, incoming.heartbeat(item), now)
        if incoming.list_missing() or not item.final:
            self._answer_writer(peer, item.writer, incoming.answer(item.writer))

    def _take_acknack(self, peer: Peer, item: wire.Acknack) -> None:
        if item.writer == self._outgoing.writer:
            missing = self._outgoing.answer(item)
            peer.is_behind = self._outgoing.is_behind(item) and not missing
            if missing:
                self._send_to(peer, [*missing, self._outgoing.beat(final=True)])
        elif item.writer == rtps.SPDP_WRITER and self._is_client:
            self._beats += 1
            ends = rtps.SPDP_READER, rtps.SPDP_WRITER
            self._send_to(peer, [wire.heartbeat(*ends, 1, 1, self._beats, final=True)])

    def _answer_writer(self, peer: Peer, writer: bytes, answer: bytes) -> None:
        """Answer a writer where it listens: built-in ones elsewhere than others."""
        own, to = self.own, peer.announced.prefix
        is_built_in = writer[3] & 0xC0 == 0xC0
        places = peer.places if is_built_in else peer.data_places
        self._send(wire.message(own.prefix, own.vendor, to, [answer]), places)

    def _take_announcement(self, by: bytes, change: Change, source: str, now: float) -> None:
        """Take in what `by` announces of itself, or a discovery server of others."""
        if change.status:
            self._forget(_guid(change)[:12])
            return
        announcement = spdp.participant(change.payload)
        if (
            announcement.domain not in (None, self.own.domain)
            or announcement.prefix == self.own.prefix
        ):
            return
        peer = self.peers.get(announcement.prefix)
        if peer is None:
            if self._has_room():
                self._meet(announcement, source, now, is_direct=by == announcement.prefix)
            return
        peer.take(announcement)
        peer.sources.update([source] if source else [])

    def _has_room(self) -> bool:
        """Return whether one more participant can be kept: the oldest without endpoints goes."""
        if len(self.peers) < _MOST_PEERS:
            return True
        peers = self.peers.values()
        idle = next((one for one in peers if not one.has_endpoints and not one.is_server), None)
        if idle is not None:
            self._forget(idle.announced.prefix)
        return idle is not None

    def _meet(
        self, announcement: Announcement, source: str, now: float, *, is_direct: bool
    ) -> None:
        """Add a participant: announce ourselves to it at once, and request its endpoints."""
        peer = self.peers[announcement.prefix] = Peer(announcement, now, is_direct=is_direct)
        peer.sources.update([source] if source else [])
        if is_direct:
            self._send(self.announcement(), peer.places)
            asked = [i.answer(writer, final=False) for writer, i in peer.incoming.items()]
            self._send_to(peer, [*asked, self._outgoing.beat()])
        for writer in [w for w in self.writers.values() if w.guid[:12] == announcement.prefix]:
            self._match(writer)  # a server may announce endpoints first

    def _greet(self, prefix: bytes, now: float) -> None:
        """Add a discovery server that sends before it has announced itself."""
        announcement = Announcement(
            prefix, rtps.FAST_DDS, meta=tuple(self.servers), properties=SERVER
        )
        if self._has_room():
            self._meet(announcement, "", now, is_direct=True)

    def _forget(self, prefix: bytes) -> None:
        if self.peers.pop(prefix, None) is None:
            return
        for found in (self.writers, self.readers, self._sources):
            for guid in [guid for guid in found if guid[:12] == prefix]:
                del found[guid]

    # What we do with it

    def _apply(self, guid: bytes, changes: Sequence[Change], now: float) -> None:
        """Take in the samples of a reliable writer."""
        for change in changes:
            if guid[12:] == rtps.SPDP_WRITER:
                self._take_announcement(guid[:12], change, "", now)
            elif guid[12:] == discovery.PUBLICATIONS_WRITER:
                self._take_endpoint(change, self.writers)
            elif guid[12:] == discovery.SUBSCRIPTIONS_WRITER:
                self._take_endpoint(change, self.readers)
            elif not change.status:
                try:
                    self.peers[guid[:12]].nodes = messages.nodes(change.payload)
                except messages.Unreadable as cause:
                    raise rtps.Malformed(str(cause)) from cause

    def _take_endpoint(self, change: Change, endpoints: dict[bytes, Endpoint]) -> None:
        if change.status:
            endpoints.pop(_guid(change), None)
            self._sources.pop(_guid(change), None)
        elif len(endpoints) < _MOST_ENDPOINTS:
            found = discovery.endpoint(change.payload)
            endpoints[found.guid] = found
            if peer := self.peers.get(found.guid[:12]):
                peer.has_endpoints = True
            if endpoints is self.writers:
                self._match(found)

    # What we subscribe to

    def hear(self, topic: str, keep: int, leave: Callable[[Subscription], None]) -> Subscription:
        """Subscribe to a topic by its name in ROS; `leave` ends it."""
        subscription = Subscription(topic, keep, leave)
        self._subscriptions.append(subscription)
        for writer in [w for w in self.writers.values() if names.topic_name(w.topic) == topic]:
            self._connect(writer, subscription)
        return subscription

    def leave(self, subscription: Subscription) -> None:
        """Remove the readers of a topic."""
        if subscription in self._subscriptions:
            self._subscriptions.remove(subscription)
        for guid, sources in list(self._sources.items()):
            self._sources[guid] = [
                source for source in sources if source.subscription is not subscription
            ]
            if not self._sources[guid]:
                del self._sources[guid]
        if any(other.topic == subscription.topic for other in self._subscriptions):
            return
        for reader in [
            r for r in self._own_readers if names.topic_name(r.topic) == subscription.topic
        ]:
            self._outgoing.drop(self._own_readers.pop(reader))
            gone = rtps.serialized([(discovery.PID_ENDPOINT, reader.guid)])
            self._publish(reader.guid, gone, is_gone=True)

    def _match(self, writer: Endpoint) -> None:
        """Announce a reader for a writer, if its topic is subscribed to."""
        if len(self._own_readers) >= _MOST_READERS:
            return
        if writer.topic == names.NODES:
            self._listen(writer)
            return
        topic, known = names.topic_name(writer.topic), set(self._sources)
        for subscription in self._subscriptions:
            if subscription.topic == topic and writer.guid not in known:
                self._connect(writer, subscription)

    def _connect(self, writer: Endpoint, subscription: Subscription) -> None:
        source = Source(subscription, names.type_name(writer.type))
        self._sources.setdefault(writer.guid, []).append(source)
        self._announce(writer, is_reliable=False)

    def _listen(self, writer: Endpoint) -> None:
        """Subscribe to the list of a participant's nodes."""
        reader = self._announce(writer, is_reliable=True)
        peer = self.peers.get(writer.guid[:12])
        if peer and writer.guid[12:] not in peer.incoming:
            peer.incoming[writer.guid[12:]] = Incoming(reader, holds_back=not peer.is_direct)

    def _announce(self, writer: Endpoint, *, is_reliable: bool) -> bytes:
        """Announce a reader that fits a writer, once; return its entity id."""
        wanted = writer._replace(guid=b"", is_reliable=is_reliable, is_local=is_reliable)
        for reader in self._own_readers:
            if reader._replace(guid=b"") == wanted and reader.is_keyed == writer.is_keyed:
                return reader.guid[12:]
        kind = _KEY if writer.is_keyed else _NO_KEY
        entity = next(self._ids).to_bytes(3, "big") + kind
        reader = wanted._replace(guid=self.own.prefix + entity)
        self._own_readers[reader] = self._publish(reader.guid, discovery.reader_payload(reader))
        return entity

    def _publish(self, guid: bytes, payload: bytes, *, is_gone: bool = False) -> int:
        """Announce a reader to all others; if it is lost, it is sent after the next heartbeat."""
        pairs = [(rtps.PID_KEY_HASH, guid)] + ([(rtps.PID_STATUS, rtps.GONE)] if is_gone else [])
        inline = self._inline(self._outgoing.writer, self._outgoing.last + 1, *pairs)
        number = self._outgoing.add(inline, payload, is_key=is_gone)
        sent = [self._outgoing.sample(number), self._outgoing.beat()]
        for peer in self.peers.values():
            self._send_to(peer, sent)
        return number


def _guid(change: Change) -> bytes:
    return change.key or discovery.key_of(change.payload)

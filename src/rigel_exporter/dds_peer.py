"""Another participant: what it announced, and whether it answers.

Why: a lease of 20 s and more shows late that a process has stopped, and a process that hangs may
keep its lease. Reliability works with Fast DDS and Cyclone DDS: a reader that gets a heartbeat
without the final flag acknowledges it (DDSI-RTPS 2.5: 8.4.12.2). So, if nothing was received from a
participant for 2 s, its built-in reader for subscriptions is sent one; every participant that can
be matched has that reader. After three in a row without an answer, the participant does not answer:
8 s show that a process was stopped or killed. Unanswered heartbeats are counted, not seconds, since
the exporter itself may get no processor time.

Clients of a discovery server keep their built-in endpoints for it. Their ros_discovery_info is
received directly, and its latest sample is never acknowledged: so its writer sends heartbeats as
long as it lives, in Fast DDS every 3 s. (A request for an acknowledged sample gets no answer.)

It must not use sockets or a clock.
"""

from __future__ import annotations

from rigel_exporter import dds_discovery as discovery
from rigel_exporter.dds_reliable import Incoming
from rigel_inpod import rtps
from rigel_inpod.spdp import Announcement, Place

SERVER = (("PARTICIPANT_TYPE", "SERVER"),)
_RELAYED = 6  # leases after which we forget a participant that the server should have forgotten
_BACKUP = (("PARTICIPANT_TYPE", "BACKUP"),)
_BUILT_IN = (
    (discovery.HAS_PUBLICATIONS, discovery.PUBLICATIONS_WRITER, discovery.PUBLICATIONS_READER),
    (discovery.HAS_SUBSCRIPTIONS, discovery.SUBSCRIPTIONS_WRITER, discovery.SUBSCRIPTIONS_READER),
)

PING = 2.0  # seconds of silence after which it is sent a heartbeat
PATIENCE = 3  # heartbeats without an answer until it counts as not answering
_PROCESS = ("__ProcessName", "fastdds.physical_data.process")  # Cyclone DDS', Fast DDS'


class Peer:
    """Another participant of the domain.

    Attributes:
        sources: where its announcements came from.
        nodes: the ROS nodes that it announces, and the GUIDs of their endpoints.
        incoming: its built-in and other reliable writers, by their entity ids.
        is_direct: it announced itself; else a discovery server did, and also removes it, since
            clients of servers do not send discovery to each other.
        is_behind: it has not acknowledged everything that we sent.
        has_endpoints: it has announced a writer or reader: it is more than an announcement.
    """

    def __init__(self, announcement: Announcement, now: float, *, is_direct: bool = True) -> None:
        self.announced, self.heard, self.is_direct = announcement, now, is_direct
        self.is_behind = self.has_endpoints = False
        self.sources: set[str] = set()
        self.nodes: dict[str, frozenset[bytes]] = {}
        self.incoming: dict[bytes, Incoming] = {}
        self._asked, self._unanswered = now, 0
        self.take(announcement)

    def take(self, announcement: Announcement) -> None:
        """Take in what it announces, again or for the first time."""
        self.announced = announcement
        if not self.is_direct:
            return
        if self.is_server:
            self.incoming.setdefault(rtps.SPDP_WRITER, Incoming(rtps.SPDP_READER))
        for bit, writer, reader in _BUILT_IN:
            if announcement.endpoints & bit:
                self.incoming.setdefault(writer, Incoming(reader))

    @property
    def is_server(self) -> bool:
        """Whether it is a discovery server of Fast DDS."""
        return any(pair in self.announced.properties for pair in (*SERVER, *_BACKUP))

    def hear(self, now: float) -> None:
        """Record that it sent something."""
        self.heard, self._unanswered = now, 0

    @property
    def answers(self) -> bool:
        """Whether it answers our heartbeats."""
        return self._unanswered <= PATIENCE  # the latest may still be answered

    def is_to_be_asked(self, now: float) -> bool:
        """Whether it was silent so long that it must be asked now; this counts as asked."""
        can_answer = self.is_direct or self.incoming
        if not can_answer or now - max(self.heard, self._asked) < PING:
            return False
        self._asked, self._unanswered = now, self._unanswered + 1
        return True

    def is_expired(self, now: float) -> bool:
        """Whether its lease is over."""
        silence = now - self.heard
        if self.is_direct:
            return silence > self.announced.lease
        return bool(self.incoming) and silence > _RELAYED * self.announced.lease

    @property
    def places(self) -> tuple[Place, ...]:
        """Where it takes what discovery sends: of several addresses the one that it sent from."""
        near = tuple(place for place in self.announced.meta if place[0] in self.sources)
        return near or self.announced.meta

    @property
    def data_places(self) -> tuple[Place, ...]:
        """Where it takes what its other endpoints are sent."""
        near = tuple(place for place in self.announced.data if place[0] in self.sources)
        return near or self.announced.data or self.places

    @property
    def is_ros(self) -> bool:
        """Whether ROS' middleware made it: its nodes announce their names, perhaps later."""
        return self.announced.user_data.startswith("enclave=")

    @property
    def name(self) -> str:
        """What it is called where it has no ROS nodes: the same after a restart."""
        properties = dict(self.announced.properties)
        process = next((properties[key] for key in _PROCESS if properties.get(key)), "")
        own = self.announced.name.strip("/") or process
        return own or rtps.VENDORS.get(int.from_bytes(self.announced.vendor, "big"), "participant")

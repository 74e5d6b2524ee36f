"""Which messages were carried out, perhaps without the broker having noticed it.

A broker sends a message of QoS 1 again if the connection ended before it was acknowledged. Such a
copy has the number of the first one, and a mark.
"""

from __future__ import annotations

from collections import OrderedDict

import attrs

from rigel_muto.agent.commands import Arrival

#: Messages that are remembered: more than brokers may send without an acknowledgement.
REMEMBERED = 500


@attrs.frozen(kw_only=True)
class Delivery:
    """A message as the broker sent it.

    Attributes:
        number: MQTT's packet identifier; 0 for QoS 0.
        kept: the broker keeps it until it is acknowledged (QoS 1).
        again: the broker marks it as a copy.
        connection: the number of the connection that it came by; only there it can be acknowledged.
        session: the number of the broker's session, which may outlast connections.
    """

    arrival: Arrival
    number: int = 0
    kept: bool = False
    again: bool = False
    connection: int = 0
    session: int = 0


class Memory:
    """Messages of one session that were carried out."""

    def __init__(self) -> None:
        self._done: OrderedDict[tuple[int, int], Arrival] = OrderedDict()

    def note(self, delivery: Delivery) -> None:
        """Remember that a message was carried out."""
        if not delivery.kept:
            return
        key = (delivery.session, delivery.number)
        self._done[key] = delivery.arrival
        self._done.move_to_end(key)
        if len(self._done) > REMEMBERED:
            self._done.popitem(last=False)

    def knows(self, delivery: Delivery) -> bool:
        """Return whether a message is the copy of one that was carried out."""
        if not (delivery.kept and delivery.again):
            return False
        return self._done.get((delivery.session, delivery.number)) == delivery.arrival

"""A copy of a message that was carried out is known; anything else is new."""

from __future__ import annotations

import attrs
import pytest

from rigel_muto.agent.broker import REMEMBERED, CarriedOut, Delivery
from rigel_muto.agent.commands import Arrival

FIRST = Delivery(arrival=Arrival(topic="a", payload=b"x"), number=1, kept=True)
COPY = attrs.evolve(FIRST, again=True, connection=2)


@pytest.mark.parametrize(
    ("delivery", "known"),
    [
        (COPY, True),
        (attrs.evolve(COPY, again=False), False),
        (attrs.evolve(COPY, number=2), False),
        (attrs.evolve(COPY, session=1), False),
        (attrs.evolve(COPY, arrival=Arrival(topic="a", payload=b"y")), False),
    ],
)
def test_a_copy_has_number_mark_session_and_content(delivery: Delivery, *, known: bool) -> None:
    carried_out = CarriedOut()
    assert not carried_out.knows(delivery)
    carried_out.note(FIRST)
    assert carried_out.knows(delivery) is known


def test_what_the_broker_does_not_keep_has_no_copies() -> None:
    carried_out = CarriedOut()
    carried_out.note(attrs.evolve(FIRST, kept=False))
    assert not carried_out.knows(COPY)


def test_old_messages_are_forgotten() -> None:
    carried_out = CarriedOut()
    for number in range(1, REMEMBERED + 2):
        carried_out.note(attrs.evolve(FIRST, number=number))
    assert not carried_out.knows(COPY)
    assert carried_out.knows(attrs.evolve(COPY, number=2))

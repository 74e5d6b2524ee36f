"""What joins a deploy by entry points."""

from __future__ import annotations

import pytest

from rigel_k8s.app.deploying import guests
from rigel_k8s.errors import RigelK8sError


def test_all_guests_of_the_wheel_are_there() -> None:
    """Each with a class of its own, in the order of their names."""
    found = [type(guest).__name__ for guest in guests.load_guests()]
    assert found == ["GraphGuest", "MultusGuest", "StackGuest"]


def test_an_installation_without_entry_points_deploys_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The stack and Multus would be left out silently."""
    monkeypatch.setattr(guests, "list_names", lambda group: set())
    with pytest.raises(RigelK8sError, match="no entry points") as caught:
        guests.load_guests()
    assert caught.value.hint

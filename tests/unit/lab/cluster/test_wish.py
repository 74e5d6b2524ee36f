"""What is asked of `up` is checked before anything is started."""

from __future__ import annotations

import click
import pytest

from rigel_k8s.errors import UserError
from rigel_lab.cli.cluster import up
from rigel_lab.cluster.addons import EXTRAS, list_offered
from rigel_lab.cluster.components import ON_REQUEST, Components
from rigel_lab.cluster.lifecycle import list_builds
from rigel_lab.cluster.state import State
from rigel_lab.cluster.wish import Wish


def state(**rest: object) -> State:
    """A cluster of three nodes."""
    return State("a", 3, "10.64.0.0/14", "boot", "1.34.4", Components({}, "/p"), **rest)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wish", "told"),
    [
        (Wish(nodes=0), "a cluster of 0 nodes"),
        (Wish(extras=("moon",)), "unknown extra moon"),
    ],
)
def test_what_cannot_be_is_refused(wish: Wish, told: str) -> None:
    """Each refusal says what is possible."""
    with pytest.raises(UserError, match=told) as caught:
        wish.check()
    assert caught.value.hint


@pytest.mark.parametrize(
    ("wish", "data_dir", "told"),
    [
        (Wish(nodes=2), None, "has 3 nodes, not 2"),
        (Wish(data_dir="/data"), None, "was not made with --k3s /data"),
        (Wish(data_dir="/data"), "/other", "was not made with --k3s /data"),
    ],
)
def test_a_cluster_stays_what_it_is(wish: Wish, data_dir: str | None, told: str) -> None:
    """Another number of nodes or layout is refused, with the way out."""
    with pytest.raises(UserError, match=told) as caught:
        wish.compare(state(data_dir=data_dir))
    assert "rigel cluster down --name a" in (caught.value.hint or "")


def test_what_is_not_asked_for_is_as_it_is() -> None:
    """A plain `up` fits every cluster, and so does the same wish again."""
    for wish in (Wish(), Wish(nodes=3, data_dir="/data"), Wish(extras=tuple(EXTRAS))):
        wish.compare(state(data_dir="/data"))


def test_a_lost_cluster_is_made_anew_as_it_was() -> None:
    """After a restart of the machine nothing need be said again; what is said counts."""
    lost = state(extras=["multus"], data_dir="/data")
    assert Wish().complete_from(lost) == Wish(3, ["multus"], "/data")
    assert Wish(nodes=1).complete_from(lost) == Wish(1, ["multus"], "/data")
    assert Wish().complete_from(state()) == Wish(3, [])


def test_builds_of_a_wish_and_of_its_cluster_are_the_same() -> None:
    """What is built first is what is looked for later."""
    wish = Wish(extras=("multus",), data_dir="/data")
    builds = list_builds(wish)
    assert builds == list_builds(state(extras=["multus"], data_dir="/data")) == ["multus", "k3s"]
    assert set(builds) <= set(ON_REQUEST)


def test_the_command_line_offers_what_there_is() -> None:
    """Its choices, which are written down there for a quick start, are those of the product."""
    choices = {
        p.opts[0]: tuple(p.type.choices) for p in up.params if isinstance(p.type, click.Choice)
    }
    assert choices["--with"] == tuple(EXTRAS)
    assert all(list_offered([extra]) for extra in EXTRAS if extra != "kubectl")

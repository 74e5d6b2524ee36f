"""The rates of the last minutes that a page gets."""

from __future__ import annotations

from rigel_graph.types import GraphTopic, RosGraph
from rigel_ui.feed import Entries
from rigel_ui.graphs import KEPT, MOST, add_rates

GRAPH = RosGraph(
    topics=(
        GraphTopic("/scan", rate=9.876),
        GraphTopic("/slow", rate=0.01234),
        GraphTopic("/unmeasured"),
        GraphTopic("/rosout", rate=3.0),
    )
)


def test_a_reading_has_the_rates_of_topics() -> None:
    """But those that each node has; a page has the time of the reading."""
    assert add_rates({}, GRAPH, 100.5, 103.0) == {
        "rates/100.5": {"begun": 100.5, "ended": 103.0, "of": {"/scan": 9.88, "/slow": 0.0123}}
    }


def test_a_reading_that_fails_is_a_gap() -> None:
    assert add_rates({}, None, 100.0, 101.0)["rates/100.0"]["of"] == {}


def test_rates_are_kept_for_ten_minutes() -> None:
    """However often the graph is read: a page's beginning stays small."""
    kept: Entries = {}
    for number in range(MOST):
        kept = add_rates(kept, GRAPH, 30.0 * number, 0)
    times = [one["begun"] for one in kept.values()]
    assert times == [30.0 * number for number in range(MOST)][-round(KEPT / 30) :]
    for number in range(2 * MOST):
        kept = add_rates(kept, GRAPH, 5000.0 + number, 0)
    assert len(kept) == MOST

"""The rates of topics in the last minutes, one entry for each reading of the ROS graph; pure.

A page gets each reading once, and a new page those before it as well. A reading without a topic is
a gap in its rate, and so is the time in which no page was open and nothing was read.
"""

from __future__ import annotations

from rigel_k8s.rosgraph.types import RosGraph
from rigel_k8s.ui.feed import Entries

KEPT = 600.0  # seconds
MOST = 60  # readings; pods that crash again and again cause many


def add_rates(old: Entries, graph: RosGraph | None, begun: float, ended: float) -> Entries:
    """Return the entries of readings with a new one, without those that are too old.

    Args:
        graph: None if it could not be read.
        begun, ended: when it was read, in seconds since 1970; on a busy cluster it takes a while.
    """
    topics = graph.topics if graph else ()
    rates = {
        topic.name: round(topic.rate, 2 if topic.rate >= 1 else 4)
        for topic in topics
        if topic.is_public and topic.rate is not None
    }
    made = {**old, f"rates/{begun}": {"begun": begun, "ended": ended, "of": rates}}
    return {key: one for key, one in list(made.items())[-MOST:] if one["begun"] > begun - KEPT}

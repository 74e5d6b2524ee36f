"""What each kind of problem in a ROS graph means; docs/errors.md is generated from it."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.kinds import Kind

ROS_GRAPH: Mapping[str, Kind] = {
    "missing": Kind(
        "the release expects a node, and it is not in the graph",
        "`rigel status` and `rigel logs NODE`",
    ),
    "no-answer": Kind(
        "a node is registered and does not answer", "restart its pod: it hangs, or it has gone"
    ),
    "not-ready": Kind(
        "a node is in the graph, and its pod is not ready", "`rigel status` shows the probe's line"
    ),
    "type": Kind(
        "the nodes of a topic name different types, so they never exchange a message",
        "build both from the same messages",
    ),
    "no-publisher": Kind(
        "a topic has subscribers and no publisher; this may be intended",
        "start the publisher, or correct a remapping",
    ),
}

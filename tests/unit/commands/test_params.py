"""What `rigel param set` says of a value that it has set."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_graph.commands import params
from rigel_graph.commands.live import Live
from rigel_graph.types import GraphNode, RosGraph
from rigel_k8s.cli.main import run
from rigel_k8s.commands.pods import pod_of


@pytest.mark.parametrize(
    ("generation", "effect"),
    [
        ("1", "the ROS master has it; most ROS 1 nodes read it only when they start"),
        ("2", "lasts until the node starts again"),
    ],
)
def test_a_set_value_is_kept_by_the_key_of_the_rigelfile(
    generation: str, effect: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Not by the name of the pod's workload; a ROS 1 node does not learn of it by itself."""
    pod = {
        "metadata": {
            "name": "diag-monitor-1",
            "namespace": "n",
            "labels": {"app.kubernetes.io/name": "diag-monitor"},
            "annotations": {"rigel-k8s/node": "diag/monitor"},
        },
        "spec": {"containers": [{"name": "ros-node"}]},
    }
    graph = RosGraph((GraphNode("/diag/monitor", workload="diag-monitor"),), (), ())
    found: Any = SimpleNamespace(cluster=nullcontext(), id=None)
    live = Live(found, [pod_of(pod)], graph, generation)
    monkeypatch.setattr(params, "release", lambda *_: found)
    monkeypatch.setattr(params, "open_live", lambda _: live)
    monkeypatch.setattr(params.ros1, "write_parameters", lambda *_: None)
    monkeypatch.setattr(params, "call", lambda *_: {"refused": None})
    assert run(["param", "set", "diag/monitor", "rate", "-1"], "rigel") == 0
    assert "/diag/monitor rate: -1" in capsys.readouterr().out
    assert run(["param", "set", "diag/monitor", "rate", "5.0"], "rigel") == 0
    assert capsys.readouterr().out.splitlines() == [
        "/diag/monitor rate: 5.0",
        f"{effect}; to keep it, write it to `parameters` of diag/monitor in the Rigelfile",
    ]

"""The order in which a cluster's machines start, also after a command that was interrupted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_lab.cluster import lifecycle
from rigel_lab.cluster.components import Components
from rigel_lab.cluster.state import State

FILLED = ["fill", "wait", "nodes"]


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is done, instead of doing it."""
    done: list[str] = []

    def note(step: str) -> Callable[..., None]:
        return lambda *_: done.append(step)

    monkeypatch.setattr(lifecycle.network, "create", note("network"))
    monkeypatch.setattr(lifecycle, "start", lambda _, __, name: done.append(f"start {name}"))
    monkeypatch.setattr(lifecycle, "push_images", note("fill"))
    monkeypatch.setattr(lifecycle, "write_resolv_conf", note("names"))
    monkeypatch.setattr(lifecycle.addons, "own_images", lambda _: ())
    monkeypatch.setattr(lifecycle.api, "wait_until_ready", note("wait"))
    monkeypatch.setattr(lifecycle.api, "create_nodes", note("nodes"))
    monkeypatch.setattr(lifecycle.api, "mark_lost", note("lost"))
    return done


@pytest.mark.parametrize(
    ("running", "furnished", "expected"),
    [
        ((), False, ["network", "start control-plane", *FILLED, "start node1"]),
        (("control-plane",), False, ["network", *FILLED, "start node1"]),
        (("control-plane", "node1"), False, ["names", *FILLED]),
        (("control-plane", "node1"), True, ["names"]),
        (("control-plane",), True, ["network", "lost", "start node1"]),
        (("node1",), True, ["names", "network", "start control-plane", *FILLED]),
    ],
)
def test_what_is_missing_is_done(
    steps: list[str],
    monkeypatch: pytest.MonkeyPatch,
    running: tuple[str, ...],
    furnished: bool,  # noqa: FBT001
    expected: list[str],
) -> None:
    """A control plane that runs may lack its images: the `up` that started it was interrupted."""
    monkeypatch.setattr(State, "process", lambda _, name: name in running or None)
    made: dict[str, Any] = {"block": "10.70.0.0/16", "boot": "b", "kubernetes": "1"}
    state = State("one", 1, components=Components({}, str(Path())), furnished=furnished, **made)
    started = lifecycle.start_machines(state, lambda _: None)
    assert steps == expected
    assert started == (len(running) < 2)

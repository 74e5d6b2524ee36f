"""The loader of composable nodes, with stand-ins for rclpy and composition_interfaces.

Neither rclcpp_components nor composition_interfaces is in a package registry: what a real container
answers is not tried here.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import attrs
import pytest

EYE = {
    "name": "/robot/eye",
    "package": "car",
    "plugin": "car::Eye",
    "parameters": {"rate": 2.0, "pid.p": 1},
    "remappings": ["image:=/image"],
    "extra_arguments": {"use_intra_process_comms": True},
}
EAR = {**EYE, "name": "/ear", "plugin": "car::Ear"}


@attrs.define
class World:
    """A component container.

    Attributes:
        is_there: whether its services are in sight; answers: whether it answers.
        refusals: what it says to the next loads.
        loaded: what was asked for, in order.
    """

    is_there: bool = True
    answers: bool = True
    refusals: list[str] = attrs.field(factory=list)
    loaded: list[SimpleNamespace] = attrs.field(factory=list)
    clients: list[str] = attrs.field(factory=list)

    def list_nodes(self, _: Any) -> SimpleNamespace:
        names = [f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in self.loaded]
        return SimpleNamespace(full_node_names=names)

    def load_node(self, request: SimpleNamespace) -> SimpleNamespace:
        if self.refusals:
            return SimpleNamespace(success=False, error_message=self.refusals.pop(0))
        self.loaded.append(request)
        return SimpleNamespace(success=True, error_message="")

    def make_client(self, kind: Any, name: str) -> SimpleNamespace:
        self.clients.append(name)
        serve = self.list_nodes if name.endswith("list_nodes") else self.load_node

        def call(request: SimpleNamespace) -> SimpleNamespace:
            answer = serve(request) if self.answers else None
            return SimpleNamespace(done=lambda: self.answers, result=lambda: answer)

        return SimpleNamespace(
            srv_name=name,
            service_is_ready=lambda: self.is_there,
            call_async=call,
            remove_pending_request=lambda _: None,
        )


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    """A container in place of ROS."""
    made = World()
    kind = SimpleNamespace(Request=SimpleNamespace)
    rclpy = ModuleType("rclpy")
    rclpy.__dict__.update(
        init=lambda **_: None,
        signals=SimpleNamespace(SignalHandlerOptions=SimpleNamespace(NO=0)),
        spin_once=lambda *_, **__: None,
        create_node=lambda *_, **__: SimpleNamespace(create_client=made.make_client),
    )
    parameter = ModuleType("rclpy.parameter")
    parameter.__dict__["Parameter"] = lambda name, value: SimpleNamespace(
        to_parameter_msg=lambda: (name, value)
    )
    srv = ModuleType("composition_interfaces.srv")
    srv.__dict__.update(ListNodes=kind, LoadNode=kind)
    for module in (rclpy, parameter, ModuleType("composition_interfaces"), srv):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return made


@pytest.fixture
def load(
    script: Callable[[str], ModuleType],
    world: World,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., None]:
    """Load components into /container."""
    made, loading = script("components"), script("loading")
    monkeypatch.setattr(script("progress"), "FILES", (str(tmp_path / "progress"),))
    monkeypatch.setattr(
        loading, "signal", SimpleNamespace(SIGINT=2, SIGTERM=15, signal=lambda *_: None)
    )
    monkeypatch.setattr(made, "ANSWER", 0.001)
    monkeypatch.setattr(loading, "time", SimpleNamespace(sleep=lambda _: wake(world)))

    def run(*components: dict[str, Any]) -> None:
        plan = {"node": "/container", "components": components}
        loading.load_all(plan, made.Container("/container"))

    return run


def wake(world: World) -> None:
    """One thing that was missing is there after each rest."""
    if world.is_there:
        world.answers = True
    world.is_there = True


def test_a_request_says_what_to_load(load: Callable[..., None], world: World) -> None:
    """All of a component's options are in it."""
    load(EYE)
    assert world.clients == ["/container/_container/list_nodes", "/container/_container/load_node"]
    (request,) = world.loaded
    assert (request.package_name, request.plugin_name) == ("car", "car::Eye")
    assert (request.node_name, request.node_namespace) == ("eye", "/robot")
    assert request.remap_rules == ["image:=/image"]
    assert request.parameters == [("pid.p", 1), ("rate", 2.0)]
    assert request.extra_arguments == [("use_intra_process_comms", True)]


def test_a_container_is_asked_once_it_answers(
    load: Callable[..., None], world: World, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that was lost stays in sight for a while; the log says what is waited for."""
    world.is_there = world.answers = False
    load(EYE, EAR)
    log = capsys.readouterr().out
    assert "not load components yet: /container/_container/list_nodes is not there\n" in log
    assert "not load components yet: /container/_container/list_nodes does not answer\n" in log
    assert [one.plugin_name for one in world.loaded] == ["car::Eye", "car::Ear"]


def test_the_containers_own_words_are_the_cause(
    load: Callable[..., None], world: World, capsys: pytest.CaptureFixture[str]
) -> None:
    """A component that was refused is tried again, and none is loaded twice."""
    world.refusals = ["Failed to find class", "\N{WARNING SIGN} a\nb"]
    load(EYE, EYE, EAR)
    log = capsys.readouterr().out
    assert "cannot load /robot/eye (car::Eye) (attempt 1): Failed to find class\n" in log
    assert "cannot load /robot/eye (car::Eye) (attempt 2): ? a b\n" in log
    assert [one.plugin_name for one in world.loaded] == ["car::Eye", "car::Ear"]
    assert "/container has loaded /robot/eye, /robot/eye, /ear\n" in log

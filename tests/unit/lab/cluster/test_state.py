"""What is remembered between two commands."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rigel_k8s.errors import UserError
from rigel_lab.cluster import paths, removal
from rigel_lab.cluster.components import Components
from rigel_lab.cluster.state import State, find


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A state directory of the test's own."""
    monkeypatch.setattr(paths, "STATE", tmp_path)
    return tmp_path


def state(name: str, **rest: object) -> State:
    found = State(name, 2, "10.64.0.0/14", "boot", "1.34.4", Components({"kubectl": "/k"}, "/p"))
    for key, value in rest.items():
        setattr(found, key, value)
    return found


def test_it_is_read_back(place: Path) -> None:
    """A saved state is the same after loading; clusters are listed by name."""
    state("b").save()
    state("a", furnished=True).save()
    assert State.load("a") == state("a", furnished=True)
    assert paths.names() == ["a", "b"]


def test_an_older_file_is_read(place: Path) -> None:
    """What older versions do not note has its default."""
    state("a").save()
    path = place / "clusters/a/cluster.json"
    content = json.loads(path.read_text())
    for key in ("extras", "offers", "data_dir", "furnished"):
        del content[key]
    path.write_text(json.dumps(content))
    assert State.load("a") == state("a")


def test_an_unknown_cluster_is_told_with_those_that_are_there(place: Path) -> None:
    """The error names the others and how to start one."""
    state("dev").save()
    with pytest.raises(UserError, match="no local cluster local; there is dev") as caught:
        find("local")
    assert caught.value.hint == "--name dev for that one, or rigel cluster up --name local"


def test_machines_of_one_cluster_are_not_those_of_another(place: Path) -> None:
    """Names are exact: `dev` has none of the namespaces of `dev-2`."""
    ours = {state("dev").layout.namespace(m) for m in state("dev").machine_names}
    theirs = {state("dev-2").layout.namespace(m) for m in state("dev-2").machine_names}
    assert ours == {"rigel-dev-control-plane", "rigel-dev-node1", "rigel-dev-node2"}
    assert not ours & theirs


def test_the_context_before_is_handed_over(place: Path) -> None:
    """A cluster that came after a removed one goes back to what was before that."""
    state("b", kubeconfigs={"/k": "rigel-a", "/other": "rigel-a"}).save()
    removal.hand_over("rigel-a", "/k", "robots")
    loaded = State.load("b")
    assert loaded is not None
    assert loaded.kubeconfigs == {"/k": "robots", "/other": "rigel-a"}

"""A cluster in memory on which releases live as on a real one, and a reporter."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest

from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Store
from tests.support.recorder import Recorder


@pytest.fixture
def fake() -> FakeCluster:
    """A cluster in memory, with controllers, and the namespace `n`."""
    cluster = FakeCluster(Store(controllers=Controllers()))
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
    cluster.calls.clear()
    return cluster


@pytest.fixture
def report() -> Recorder:
    """A reporter that remembers."""
    return Recorder()


class Today(date):
    """A day that stays: golden files with a distribution do not change when its support ends."""

    @classmethod
    def today(cls) -> Today:
        return cls(2026, 11, 24)


@pytest.fixture(autouse=True)
def today(monkeypatch: pytest.MonkeyPatch) -> None:
    """All distributions of the golden files are supported."""
    monkeypatch.setattr("rigel_k8s.app.checks.application.date", Today)


@pytest.fixture(autouse=True)
def state_home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A place for what is remembered, which no other test and no user has."""
    place = tmp_path_factory.mktemp("state")
    monkeypatch.setenv("XDG_STATE_HOME", str(place))
    return place

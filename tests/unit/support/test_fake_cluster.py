"""The fake keeps the promises that a real API server keeps (tests/cluster/test_contract.py)."""

from __future__ import annotations

import pytest

from tests.support.contract import ClusterContract
from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Store


class TestFakeCluster(ClusterContract):
    @pytest.fixture
    def cluster(self) -> FakeCluster:
        return FakeCluster(Store(controllers=Controllers()))

    @pytest.fixture
    def other(self, cluster: FakeCluster) -> FakeCluster:
        return cluster.as_manager("argo")

    @pytest.fixture
    def namespace(self, cluster: FakeCluster) -> str:
        cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
        return "n"

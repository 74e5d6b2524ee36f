"""A real API server keeps the promises that unit tests get from their fake."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import pytest

from rigel_k8s.kube.answers import read_mapping
from rigel_k8s.objects.refs import ObjectRef, ref_of
from tests.support.contract import ClusterContract

pytestmark = pytest.mark.cluster


@attrs.frozen
class Argo:
    """The same cluster, written to by another tool."""

    cluster: Any

    def apply(self, manifest: Mapping[str, Any], *, force: bool = False) -> dict[str, Any]:
        query = {"fieldManager": "argo", "force": force and "true"}
        media = "application/apply-patch+yaml"
        return self.send(ref_of(manifest), manifest, media, query)

    def patch(self, ref: ObjectRef, body: Mapping[str, Any]) -> dict[str, Any]:
        return self.send(ref, body, "application/merge-patch+json", {"fieldManager": "argo"})

    def send(self, ref: ObjectRef, body: object, media: str, query: Any) -> dict[str, Any]:
        url = self.cluster.client.path_of(ref, "test", query=query)
        answer: dict[str, Any] = self.cluster.client.call(
            "PATCH", url, "test", read_mapping, body=body, media=media
        )
        return answer


class TestApiServer(ClusterContract):
    @pytest.fixture
    def other(self, cluster: Any) -> Argo:
        return Argo(cluster)

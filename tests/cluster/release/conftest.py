"""Small releases for the tests of deploys, and a reporter that remembers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import attrs
import pytest

from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.recorder import Recorder
from tests.support.releases import down
from tests.support.until import until

FOREVER = "trap 'exit 0' TERM; while true; do sleep 0.1; done"


@attrs.frozen
class Maker:
    """Makes manifests in one namespace, and releases of them."""

    namespace: str
    image: str

    @property
    def release(self) -> ReleaseId:
        return ReleaseId(self.namespace, "demo")

    def desired(self, *objects: dict[str, Any], **more: Any) -> Desired:
        return Desired(self.release, objects, **more)

    def config(self, name: str = "config", **data: str) -> dict[str, Any]:
        meta = {"name": name, "namespace": self.namespace}
        return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": meta, "data": data}

    def deployment(
        self,
        name: str = "talker",
        command: str = FOREVER,
        *,
        image: str = "",
        replicas: int = 1,
        pod: dict[str, Any] | None = None,
        **container: Any,
    ) -> dict[str, Any]:
        labels = {"app.kubernetes.io/name": name, RELEASE_LABEL: "demo"}
        meta: dict[str, Any] = {"name": name, "namespace": self.namespace}
        own = {
            "name": "node",
            "image": image or self.image,
            "command": ["sh", "-c", command],
            **container,
        }
        spec = {"terminationGracePeriodSeconds": 1, "containers": [own], **(pod or {})}
        return {
            "apiVersion": "apps/v1",
            "kind": "Deployment",
            "metadata": meta,
            "spec": {
                "replicas": replicas,
                "strategy": {"type": "Recreate"},
                "selector": {"matchLabels": {"app.kubernetes.io/name": name}},
                "template": {"metadata": {"labels": labels}, "spec": spec},
            },
        }

    def claim(self, name: str = "data", storage_class: str | None = None) -> dict[str, Any]:
        spec: dict[str, Any] = {
            "accessModes": ["ReadWriteOnce"],
            "resources": {"requests": {"storage": "32Mi"}},
        }
        if storage_class is not None:
            spec["storageClassName"] = storage_class
        return {
            "apiVersion": "v1",
            "kind": "PersistentVolumeClaim",
            "metadata": {"name": name, "namespace": self.namespace},
            "spec": spec,
        }


@pytest.fixture(scope="session")
def cluster(deployer: Any) -> Any:
    """The cluster as a user sees it who has no more rights than the Role for deployers."""
    return deployer


@pytest.fixture
def report() -> Recorder:
    """A reporter that remembers."""
    return Recorder()


@pytest.fixture
def make(admin: Any, cluster: Any, namespace: str, registry: str) -> Iterator[Maker]:
    """A maker of manifests in the test's namespace; what is cluster-wide goes after the test."""
    own = ObjectRef("v1", "Namespace", "", namespace)
    until(lambda: cluster.get(own), "the right to deploy", despite=(Forbidden,))
    maker = Maker(namespace, f"{registry}/rigel-k8s/busybox:1")
    yield maker
    down(admin, maker.release, volumes=True, report=Recorder())

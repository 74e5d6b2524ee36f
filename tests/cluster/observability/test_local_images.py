"""Each image of the observability extras is pulled by its upstream name, and its program works.

Nothing is configured: what is started is what the image itself says, as the user it names.
"""

from __future__ import annotations

import tarfile
import time
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import ObjectRef
from rigel_k8s.system.oci import write_archive
from rigel_lab.cluster import oci
from rigel_lab.cluster.extras import IMAGES, shorten_name
from rigel_lab.images import exporter

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("more_images")]

#: Image -> what its program says when asked for its version.
VERSIONS = {
    IMAGES["loki"]: "loki, version 3.7.8",
    IMAGES["promtail"]: "promtail, version 3.6.15",
    IMAGES["otel-collector"]: "otelcol-k8s version 0.158.0",
    IMAGES["prometheus"]: "prometheus, version 3.13.3",
    IMAGES["kube-state-metrics"]: "kube-state-metrics, version v2.18.0",
    IMAGES["node-exporter"]: "node_exporter, version 1.12.1",
    IMAGES["prometheus-operator"]: "prometheus-operator, version 0.92.1",
    IMAGES["prometheus-config-reloader"]: "prometheus-config-reloader, version 0.92.1",
}
#: Image -> how it is asked, where it is not by this argument.
ASKED = {
    IMAGES["loki"]: {"args": ["-version"]},
    IMAGES["promtail"]: {"args": ["-version"]},
    IMAGES["kube-state-metrics"]: {"command": ["/kube-state-metrics", "version"]},
}
BY_ARGUMENT = {"args": ["--version"]}
#: Image -> port and path where its program says, started with nothing besides, that it is well.
SERVERS = {
    IMAGES["loki"]: (3100, "ready", "ready"),
    IMAGES["prometheus"]: (9090, "-/ready", "Prometheus Server is Ready"),
    IMAGES["node-exporter"]: (9100, "metrics", "node_cpu_seconds_total"),
}


@attrs.frozen
class Place:
    """A namespace in which pods can be started."""

    cluster: Any
    namespace: str

    def start(self, image: str, **container: Any) -> ObjectRef:
        """Start a pod of one image."""
        name = shorten_name(image).rpartition("/")[2].replace(":", "-").replace(".", "-")
        ref = ObjectRef("v1", "Pod", self.namespace, name)
        spec = {"name": "c", "image": image, **container}
        self.cluster.create(
            {
                "apiVersion": "v1",
                "kind": "Pod",
                "metadata": {"name": ref.name, "namespace": ref.namespace},
                "spec": {"containers": [spec], "restartPolicy": "Never"},
            }
        )
        return ref

    def ended(self, ref: ObjectRef) -> str:
        """Return what a pod printed until it ended well."""
        for event in self.cluster.watch("v1", "Pod", ref.namespace, seconds=300):
            phase = event.object.get("status", {}).get("phase")
            if event.object["metadata"]["name"] == ref.name and phase in ("Succeeded", "Failed"):
                said = "\n".join(self.cluster.logs(ref.namespace, ref.name))
                assert phase == "Succeeded", said
                return said
        raise AssertionError(f"{ref} did not end: {self.cluster.get(ref)['status']}")

    def answer(self, ref: ObjectRef, port: int, path: str) -> str:
        """Return what a pod answers, as soon as it does, through the API server."""
        end = time.monotonic() + 180
        while True:
            try:
                return str(self.cluster.get_through_proxy(ref, path, port=port).decode())
            except ClusterError:
                if time.monotonic() > end:
                    raise
                time.sleep(1)


@pytest.fixture
def place(cluster: Any, namespace: str) -> Place:
    """A namespace that has its service account, without which pods are refused."""
    for event in cluster.watch("v1", "ServiceAccount", namespace, seconds=60):
        if event.object["metadata"]["name"] == "default":
            break
    return Place(cluster, namespace)


def test_every_program_is_that_of_its_image(place: Place) -> None:
    """Pulled by upstream's name, each says who it is and in which version."""
    started = {image: place.start(image, **ASKED.get(image, BY_ARGUMENT)) for image in VERSIONS}
    for image, pod in started.items():
        assert VERSIONS[image] in place.ended(pod)


def test_servers_work_as_they_come(place: Place) -> None:
    """As upstream's image's user, with its own configuration, writing where it is told to."""
    started = {image: place.start(image) for image in SERVERS}
    for image, pod in started.items():
        port, path, words = SERVERS[image]
        assert words in place.answer(pod, port, path)


def test_loki_is_not_root(place: Place) -> None:
    """Its user has a number, so that `runAsNonRoot` needs no other word."""
    secure = {"runAsNonRoot": True}
    pod = place.start(IMAGES["loki"], args=["-version"], securityContext=secure)
    assert "loki, version" in place.ended(pod)


def test_the_exporter_comes_with_them(place: Place) -> None:
    """The image whose name deployments have by default is pulled and is the exporter."""
    pod = place.start(
        exporter.UPSTREAM, command=["/usr/bin/python3", "-c", "import rigel_exporter as e; e"]
    )
    place.ended(pod)


def test_an_archive_is_pushed_where_it_is_not_there(registry: str, tmp_path: Path) -> None:
    """The same image twice is one upload; another one takes its name over."""
    first, second = (archive(tmp_path / name, name.encode()) for name in ("one", "two"))
    name = f"rigel-test/{tmp_path.name}:1"
    assert [oci.push_archive(path, name, registry) for path in (first, first)] == [True, False]
    assert [oci.push_archive(path, name, registry) for path in (second, second, first)] == [
        True,
        False,
        True,
    ]


def archive(path: Path, content: bytes) -> Path:
    """Write an image of one file, as `rigel image` does."""
    layer, file = path.with_suffix(".layer"), path.with_suffix(".file")
    file.write_bytes(content)
    with tarfile.open(layer, "w") as tar:
        tar.add(file, "file")
    write_archive(path, [layer], {"Cmd": ["/file"]}, "localhost/x:1", created=0)
    return path

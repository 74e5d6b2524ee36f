"""Manifests written for upstream's images find in ours what they rely on."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import pytest

from rigel_k8s.observability.exporter import EXPORTER_IMAGE
from rigel_k8s.observability.manifests.program import load
from rigel_lab.cluster.components import BUILDS, ON_REQUEST, Components
from rigel_lab.cluster.extras import IMAGES, extra_images, list_offered
from rigel_lab.cluster.oci import Image
from rigel_lab.images import exporter

KUBE_STATE_METRICS = BUILDS["kube-state-metrics"]
OPERATOR = BUILDS["prometheus-operator"]
PROMETHEUS = BUILDS["prometheus"]
PROMTAIL = BUILDS["promtail"]

pytestmark = pytest.mark.programs

EXTRAS = ("observability", "promtail", "prometheus-operator")
#: As whom each runs: as upstream's says it, since `runAsNonRoot` refuses a user without a number.
USERS = {
    IMAGES["loki"]: "10001",
    IMAGES["promtail"]: None,
    IMAGES["otel-collector"]: "10001",
    IMAGES["prometheus"]: "nobody",
    IMAGES["kube-state-metrics"]: "nobody",
    IMAGES["node-exporter"]: "nobody",
    IMAGES["prometheus-operator"]: "65534",
    IMAGES["prometheus-config-reloader"]: "nobody",
}
#: What each starts, and with what.
STARTS = {
    IMAGES["loki"]: ["/usr/bin/loki", "-config.file=/etc/loki/local-config.yaml"],
    IMAGES["promtail"]: ["/usr/bin/promtail", "-config.file=/etc/promtail/config.yml"],
    IMAGES["otel-collector"]: ["/otelcol-k8s"],
    IMAGES["prometheus"]: [
        "/bin/prometheus",
        "--config.file=/etc/prometheus/prometheus.yml",
        "--storage.tsdb.path=/prometheus",
    ],
    IMAGES["kube-state-metrics"]: [
        "/kube-state-metrics",
        "--port=8080",
        "--telemetry-port=8081",
    ],
    IMAGES["node-exporter"]: ["/bin/node_exporter"],
    IMAGES["prometheus-operator"]: ["/bin/operator"],
    IMAGES["prometheus-config-reloader"]: ["/bin/prometheus-config-reloader"],
}


@pytest.fixture
def images(tmp_path: Path) -> dict[str, Image]:
    """The images, of programs that are files only."""
    busybox = tmp_path / "busybox"
    busybox.write_text("#!/bin/sh\nprintf 'busybox\\nsh\\nwget\\n'\n")
    busybox.chmod(0o755)
    programs = {"busybox": str(busybox)}
    for build in (build for extra in EXTRAS for build in ON_REQUEST[extra]):
        for name in build.programs():
            (tmp_path / name).write_text(f"{name} of {build.name}")
            programs[name] = str(tmp_path / name)
    made = extra_images(Components(programs, str(tmp_path)), EXTRAS)
    return dict(zip(list_offered(EXTRAS), made, strict=True))


def entries(image: Image) -> dict[str, tarfile.TarInfo]:
    """What is in an image."""
    with tarfile.open(fileobj=io.BytesIO(image.layer())) as tar:
        return {entry.name: entry for entry in tar}


def content(image: Image, path: str) -> str:
    """One file of an image."""
    with tarfile.open(fileobj=io.BytesIO(image.layer())) as tar:
        file = tar.extractfile(path)
        assert file
        return file.read().decode()


def test_names_are_upstreams(images: dict[str, Image]) -> None:
    """Each is pushed by the name that nodes look for, without the registry."""
    assert set(images) == set(USERS)
    assert [image.name for image in images.values()] == [n.partition("/")[2] for n in images]
    assert "registry.k8s.io/kube-state-metrics/kube-state-metrics:v2.18.0" in images
    assert "quay.io/prometheus/node-exporter:v1.12.1" in images


def test_what_rigel_deploys_is_what_is_offered() -> None:
    """The stack's own defaults are in the registry, but for Grafana."""
    programs = ("loki", "promtail", "otel-collector", "prometheus", "kube-state-metrics")
    assert set(list_offered(["observability", "promtail"])) == {
        load(f"programs/{name}.yaml")["pod"]["containers"][0]["image"]
        for name in (*programs, "node-exporter")
    }
    assert EXPORTER_IMAGE == exporter.UPSTREAM


@pytest.mark.parametrize("name", USERS)
def test_an_image_starts_as_upstreams_does(images: dict[str, Image], name: str) -> None:
    """Its user, its program and the arguments of that, which are in the image where they say."""
    image = images[name]
    config = image.config
    assert config.get("User") == USERS[name]
    assert [*config["Entrypoint"], *config.get("Cmd", [])] == STARTS[name]  # type: ignore[misc]
    found = entries(image)
    paths = [word.partition("=")[2] or word for word in STARTS[name]]
    for path in (path for path in paths if path.startswith("/")):
        assert path[1:] in found, path
    assert found[STARTS[name][0][1:]].mode == 0o755
    assert found["LICENSE"].mode == 0o644


@pytest.mark.parametrize("name", USERS)
def test_each_image_has_its_own_program(images: dict[str, Image], name: str) -> None:
    """No two are exchanged: what is started is the program of that project."""
    start = STARTS[name][0]
    program = {"operator": "prometheus-operator"}.get(Path(start).name, Path(start).name)
    assert content(images[name], start[1:]).startswith(f"{program} of ")


@pytest.mark.parametrize("name", [IMAGES["loki"], IMAGES["kube-state-metrics"]])
def test_no_shell_where_upstream_has_none(images: dict[str, Image], name: str) -> None:
    """A probe that needs a shell must fail here as it does there."""
    assert not {path for path in entries(images[name]) if path.startswith("bin")}


def test_loki_may_write_its_directories(images: dict[str, Image]) -> None:
    """They belong to its user; nothing else does."""
    found = entries(images[IMAGES["loki"]])
    owned = {path for path, entry in found.items() if (entry.uid, entry.gid) == (10001, 10001)}
    assert owned == {"etc/loki", "loki", "loki/rules", "loki/rules-temp"}


def test_prometheus_keeps_its_data_in_a_volume(images: dict[str, Image]) -> None:
    """/prometheus belongs to nobody, is a volume, and is where it starts; promtool is there."""
    image = images[IMAGES["prometheus"]]
    found = entries(image)
    assert found["prometheus"].uid == found["prometheus"].gid == 65534
    assert "nobody:x:65534:65534:" in content(image, "etc/passwd")
    assert image.config["Volumes"] == {"/prometheus": {}}
    assert image.config["WorkingDir"] == "/prometheus"
    assert found["bin/promtool"].mode == 0o755
    assert found["bin/sh"].linkname == "busybox"


def test_programs_tell_their_versions() -> None:
    """What `--version` prints is stamped in, and is the version of the image's tag."""
    assert "-X github.com/prometheus/common/version.Version=3.13.3" in " ".join(PROMETHEUS.flags())
    assert "build.Version=3.6.15" in " ".join(PROMTAIL.flags())
    assert "version.Version=v2.18.0" in " ".join(KUBE_STATE_METRICS.flags())


def test_programs_are_called_as_go_calls_them() -> None:
    """The path of a module's second major version ends in /v2, which names no program."""
    assert KUBE_STATE_METRICS.program_names == ["kube-state-metrics"]
    assert OPERATOR.program_names == ["prometheus-operator", "prometheus-config-reloader"]

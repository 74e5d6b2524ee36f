"""Images under upstream's names have what upstream's manifests rely on."""

from __future__ import annotations

import io
import subprocess
import tarfile
from pathlib import Path

import pytest

from rigel_k8s.observability.exporter import EXPORTER_IMAGE
from rigel_lab.cluster import addons
from rigel_lab.cluster.addons import EXTRAS, IMAGES, extra_images, list_offered
from rigel_lab.cluster.components import BUILDS, ON_REQUEST, Components
from rigel_lab.cluster.oci import Image
from rigel_lab.images import exporter
from rigel_multus import installation as multus
from rigel_stack.manifests.program import load

KUBE_STATE_METRICS = BUILDS["kube-state-metrics"]
OPERATOR = BUILDS["prometheus-operator"]
PROMETHEUS = BUILDS["prometheus"]
PROMTAIL = BUILDS["promtail"]

pytestmark = pytest.mark.programs

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
    """All images, of programs that are files only."""
    busybox = tmp_path / "busybox"
    busybox.write_text("#!/bin/sh\nprintf 'busybox\\nsh\\nmd5sum\\nwget\\n'\n")
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
    assert set(images) == {*USERS, *list_offered(["multus"])}
    assert [image.name for image in images.values()] == [n.partition("/")[2] for n in images]
    for name in (
        "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick",
        "ghcr.io/k8snetworkplumbingwg/whereabouts:v0.9.4",
        "registry.k8s.io/kube-state-metrics/kube-state-metrics:v2.18.0",
        "quay.io/prometheus/node-exporter:v1.12.1",
    ):
        assert name in images


def test_what_rigel_installs_is_what_is_offered() -> None:
    """The images that `network: {install: true}` asks for are those of `--with multus`."""
    wanted = {multus.MULTUS_IMAGE, multus.WHEREABOUTS_IMAGE, multus.PLUGINS_IMAGE}
    assert set(list_offered(["multus"])) == wanted


def test_what_rigel_deploys_is_what_is_offered() -> None:
    """The stack's own defaults are in the registry, but for Grafana."""
    programs = ("loki", "promtail", "otel-collector", "prometheus", "kube-state-metrics")
    assert set(list_offered(["observability", "promtail"])) == {
        load(f"programs/{name}.yaml")["pod"]["containers"][0]["image"]
        for name in (*programs, "node-exporter")
    }
    assert EXPORTER_IMAGE == exporter.UPSTREAM


def test_a_tag_is_the_version_of_what_is_built() -> None:
    """But for Promtail, whose last image is older than its last module."""
    for extra, images in EXTRAS.items():
        versions = {build.version for build in ON_REQUEST[extra]}
        for name, spec in images.items():
            tag = spec["image"].rpartition(":")[2].removeprefix("v").partition("-")[0]
            assert (tag in versions) == (name != "promtail"), name


def test_multus_image(images: dict[str, Image]) -> None:
    """The daemon's paths, root in /etc/passwd, /var/run -> /run, and a shell."""
    found = entries(images[IMAGES["multus"]])
    for name in ("multus-daemon", "multus-shim", "install_multus", "passthru", "multus"):
        assert found[f"usr/src/multus-cni/bin/{name}"].mode == 0o755
    assert found["var/run"].linkname == "/run"
    assert found["bin/sh"].linkname == "busybox"
    assert "etc/passwd" in found
    assert images[IMAGES["multus"]].config == {
        "Entrypoint": ["/usr/src/multus-cni/bin/multus-daemon"],
        "Env": ["PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"],
    }


def test_whereabouts_image(images: dict[str, Image]) -> None:
    """Programs and scripts are at the root; it starts the script, as arguments may replace."""
    found = entries(images[IMAGES["whereabouts"]])
    programs = ("whereabouts", "ip-control-loop", "node-slice-controller", "ip-reconciler")
    for name in (*programs, "install-cni.sh", "lib.sh", "token-watcher.sh"):
        assert found[name].mode == 0o755
    config = images[IMAGES["whereabouts"]].config
    assert config["Cmd"] == ["/install-cni.sh"]
    assert "Entrypoint" not in config


def test_image_of_the_standard_programs(images: dict[str, Image]) -> None:
    """It has what k3s lacks."""
    found = entries(images[IMAGES["cni-plugins"]])
    for name in ("macvlan", "ipvlan", "static", "host-local", "dhcp", "tuning", "bridge"):
        assert found[f"opt/cni/bin/{name}"].mode == 0o755


@pytest.mark.parametrize(
    ("variables", "copied"),
    [({}, "new new"), ({"UPDATE_CNI_BINARIES": "false"}, "old new")],
)
def test_the_script_that_installs_the_standard_programs(
    tmp_path: Path, variables: dict[str, str], copied: str
) -> None:
    """It copies all but what it is told to skip, and keeps what is there where it is told so."""
    source, target = tmp_path / "from", tmp_path / "to"
    for name in ("bridge", "macvlan", "static"):
        (source / name).parent.mkdir(exist_ok=True)
        (source / name).write_text("new")
    target.mkdir()
    (target / "bridge").write_text("old")
    script = Path(addons.__file__).with_name("install-cnis.sh").read_text()
    script = script.replace("/host/opt/cni/bin", str(target)).replace("/opt/cni/bin", str(source))
    environment = {"PATH": "/usr/bin:/bin", "SKIP_CNI_BINARIES": "static,x", **variables}
    subprocess.run(["/bin/sh", "-c", script], env=environment, check=True, capture_output=True)
    assert " ".join((target / name).read_text() for name in ("bridge", "macvlan")) == copied
    assert not (target / "static").exists()


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

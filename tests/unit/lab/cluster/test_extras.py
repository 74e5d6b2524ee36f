"""Images under upstream's names are what upstream's manifests expect."""

from __future__ import annotations

import io
import subprocess
import tarfile
from pathlib import Path

import pytest

from rigel_k8s.network import multus
from rigel_lab.cluster import extras
from rigel_lab.cluster.components import BUILDS, ON_REQUEST, Components
from rigel_lab.cluster.extras import EXTRAS, IMAGES, extra_images, list_offered
from rigel_lab.cluster.oci import Image

MULTUS = BUILDS["multus"]
PLUGINS = BUILDS["cni-plugins"]
WHEREABOUTS = BUILDS["whereabouts"]

pytestmark = pytest.mark.programs


@pytest.fixture
def images(tmp_path: Path) -> dict[str, Image]:
    """The images, of programs that are files only."""
    busybox = tmp_path / "busybox"
    busybox.write_text("#!/bin/sh\nprintf 'busybox\\nsh\\nmd5sum\\n'\n")
    busybox.chmod(0o755)
    programs = {"busybox": str(busybox)}
    for build in (MULTUS, WHEREABOUTS, PLUGINS):
        for name in build.programs():
            (tmp_path / name).write_text(f"{name} of {build.name}")
            programs[name] = str(tmp_path / name)
    made = extra_images(Components(programs, str(tmp_path)), ["multus"])
    return dict(zip(list_offered(["multus"]), made, strict=True))


def entries(image: Image) -> dict[str, tarfile.TarInfo]:
    """What is in an image."""
    with tarfile.open(fileobj=io.BytesIO(image.layer())) as tar:
        return {entry.name: entry for entry in tar}


def test_names_are_upstreams(images: dict[str, Image]) -> None:
    """Each is pushed by the name that nodes look for, without the registry."""
    assert "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick" in images
    assert "ghcr.io/k8snetworkplumbingwg/whereabouts:v0.9.4" in images
    assert [image.name for image in images.values()] == [n.partition("/")[2] for n in images]


def test_what_rigel_installs_is_what_is_offered() -> None:
    """The images that `network: {install: true}` asks for are those of `--with multus`."""
    wanted = {multus.MULTUS_IMAGE, multus.WHEREABOUTS_IMAGE, multus.PLUGINS_IMAGE}
    assert set(list_offered(["multus"])) == wanted


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
    script = Path(extras.__file__).with_name("install-cnis.sh").read_text()
    script = script.replace("/host/opt/cni/bin", str(target)).replace("/opt/cni/bin", str(source))
    environment = {"PATH": "/usr/bin:/bin", "SKIP_CNI_BINARIES": "static,x", **variables}
    subprocess.run(["/bin/sh", "-c", script], env=environment, check=True, capture_output=True)
    assert " ".join((target / name).read_text() for name in ("bridge", "macvlan")) == copied
    assert not (target / "static").exists()

"""The definitions are upstream's, of the versions that are installed."""

from __future__ import annotations

from importlib.resources import files

from rigel_multus import installation
from rigel_multus.manifests import DEFINITIONS, read_definitions

IMAGES = {
    "k8s.cni.cncf.io": installation.MULTUS_IMAGE,
    "whereabouts.cni.cncf.io": installation.WHEREABOUTS_IMAGE,
}


def test_every_file_is_used_and_says_where_it_is_from() -> None:
    """Each begins with its source, the version that the image has, and the licence."""
    used = {item["metadata"]["name"] for item in read_definitions(DEFINITIONS)}
    found = list(files("rigel_multus").joinpath("crds").iterdir())
    for file in found:
        group, plural = file.name.removesuffix(".yaml").split("_")
        assert f"{plural}.{group}" in used
        head = file.read_text("utf-8").split("apiVersion")[0]
        version = IMAGES[group].rpartition(":v")[2].removesuffix("-thick")
        assert f" {version}, " in head, file.name
        assert "Apache-2.0" in head, file.name
    assert len(found) == len(used)

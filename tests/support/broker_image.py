"""Debian's mosquitto as an image, for agents that run in pods: they do not reach this machine."""

from __future__ import annotations

from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import Entry, layer
from rigel_lab.images.base.bootstrap import EXTRACT
from rigel_lab.images.base.build import EPOCH, BaseImage, Recipe
from rigel_lab.images.base.build import build as build_recipe

CONFIG = "/etc/mosquitto.conf"


def build(report: Reporter) -> BaseImage:
    """Return the image's archive; build it where the cache lacks it."""
    config = Entry(CONFIG.lstrip("/"), b"listener 1883\nallow_anonymous true\n")
    recipe = Recipe(
        title="image of mosquitto",
        family="test-images",
        name="mosquitto",
        reference="localhost/rigel-k8s/mosquitto:test",
        suite="bookworm",
        packages=("mosquitto",),
        config={"Entrypoint": ["/usr/sbin/mosquitto", "-c", CONFIG], "User": "65532:65532"},
        overlay=layer([config], mtime=EPOCH),
        variant=EXTRACT,
    )
    return build_recipe(recipe, report)

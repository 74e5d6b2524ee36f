"""What a cluster offers on request: the images of extras.yaml, under their upstream names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.yaml_text import Loader
from rigel_lab.cluster.commands import run
from rigel_lab.cluster.components import ON_REQUEST, Components
from rigel_lab.cluster.oci import Image

#: What `--with` can request: its images by a short name, each as the file describes it.
EXTRAS: Mapping[str, Mapping[str, Mapping[str, Any]]] = yaml.load(
    Path(__file__).with_name("extras.yaml").read_text("utf-8"), Loader
)
#: Short names -> the names under which nodes pull the images.
IMAGES = {name: spec["image"] for extra in EXTRAS.values() for name, spec in extra.items()}


def list_offered(extras: Iterable[str]) -> list[str]:
    """Return the names under which nodes pull the requested images."""
    return [spec["image"] for extra in extras for spec in EXTRAS[extra].values()]


def extra_images(components: Components, extras: Iterable[str]) -> list[Image]:
    return [
        make_image(components, extra, spec) for extra in extras for spec in EXTRAS[extra].values()
    ]


def make_image(components: Components, extra: str, spec: Mapping[str, Any]) -> Image:
    """Return an image as the file describes it."""
    programs = dict(spec.get("programs", {}))
    for build in ON_REQUEST[extra]:
        if build.name == spec.get("build"):
            programs.update({f"{spec['into']}{name}": name for name in build.program_names})
    links = dict(spec.get("links", {}))
    if spec.get("shell"):
        programs["bin/busybox"] = "busybox"
        listed = run([components.program("busybox"), "--list"]).split()
        links.update({f"bin/{tool}": "busybox" for tool in listed if tool != "busybox"})
    files: dict[str, Path | str] = {
        path: Path(components.program(name)) for path, name in programs.items()
    }
    for path, name in spec.get("texts", {}).items():
        files[path] = Path(components.program(name)).read_text()
    for path, name in spec.get("scripts", {}).items():
        files[path] = Path(__file__).with_name(name)
    if "users" in spec:
        users = spec["users"].items()
        accounts = [f"{name}:x:{number}:{number}::/:/sbin/nologin\n" for name, number in users]
        groups = [f"{name}:x:{number}:\n" for name, number in users]
        files["etc/passwd"] = "".join(["root:x:0:0:root:/root:/bin/sh\n", *accounts])
        files["etc/group"] = "".join(["root:x:0:\n", *groups])
    return Image(
        shorten_name(spec["image"]),
        files,
        spec["entrypoint"],
        links=links,
        command=spec.get("command", ()),
        user=spec.get("user", ""),
        owned=spec.get("owned", {}),
        volume=spec.get("volume", ""),
    )


def shorten_name(name: str) -> str:
    """Return an image's name in the cluster's registry, which stands for every registry."""
    return name.partition("/")[2]

"""What a local cluster has beside Kubernetes: DNS and storage, and images in its registry.

The registry has the cluster's own images, and on request those of extras.yaml, under their
upstream names.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import attrs
import urllib3
import yaml

from rigel_k8s.errors import LocalClusterError
from rigel_k8s.yaml_text import Loader
from rigel_lab.cluster import components, oci
from rigel_lab.cluster.commands import Report, run
from rigel_lab.cluster.components import ON_REQUEST, Components
from rigel_lab.cluster.layout import Layout
from rigel_lab.cluster.oci import Image
from rigel_lab.cluster.state import State

#: (namespace, name) of what must be ready before a cluster is.
DEPLOYMENTS = (("kube-system", "coredns"), ("local-path-storage", "local-path-provisioner"))

#: What `--with` can request: its images by a short name, each as the file describes it.
EXTRAS: Mapping[str, Mapping[str, Mapping[str, Any]]] = yaml.load(
    Path(__file__).with_name("extras.yaml").read_text("utf-8"), Loader
)
#: Short names -> the names under which nodes pull the images.
IMAGES = {name: spec["image"] for extra in EXTRAS.values() for name, spec in extra.items()}

#: Images that others make for an extra: extra -> name under which nodes pull it -> what makes the
#: archive, or finds it made.
Made = Mapping[str, Mapping[str, Callable[[], Path]]]


def own_images(components: Components) -> list[Image]:
    """Return the images that the cluster itself needs."""
    shell = {f"bin/{tool}": "busybox" for tool in ("sh", "mkdir", "rm", "chmod", "ls", "cat")}
    return [
        Image(
            "rigel-k8s/pause:1",
            {"catatonit": Path(components.program("catatonit"))},
            ["/catatonit", "-P"],
        ),
        Image(
            "rigel-k8s/coredns:1", {"coredns": Path(components.program("coredns"))}, ["/coredns"]
        ),
        Image(
            "rigel-k8s/local-path-provisioner:1",
            {"local-path-provisioner": Path(components.program("local-path-provisioner"))},
            ["/local-path-provisioner"],
        ),
        Image(
            "rigel-k8s/busybox:1",
            {"bin/busybox": Path(components.program("busybox"))},
            ["/bin/sh"],
            links=shell,
        ),
    ]


def describe_objects(layout: Layout) -> list[dict[str, Any]]:
    """Return the manifests of DNS and storage, in the order in which they can be applied."""
    servers = (layout.directory / "node1" / "resolv.conf").read_text()
    text = Template(Path(__file__).with_name("addons.yaml").read_text("utf-8")).substitute(
        registry=layout.registry,
        dns=layout.addresses.dns_service,
        forward="forward . /etc/resolv.conf" if servers else "",
    )
    return list(yaml.safe_load_all(text))


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


def offer(state: State, extras: Sequence[str], made: Made, report: Report) -> None:
    """Put what a cluster does not offer yet into its registry, which keeps it."""
    offers = list_offered(extras)
    if not components.names(extras) <= state.components.go.keys():
        parts = components.obtain(report, extras).go
        # The programs of a running cluster stay as they are, also for a newer rigel.
        state.components = attrs.evolve(state.components, go=parts | state.components.go)
        remember(state, extras, ())
    if not set(offers) <= set(state.offers):
        report(f"Adding {', '.join(extras)} to the registry")
        push_images(state.layout, extra_images(state.components, extras))
        remember(state, extras, offers)
    for others in (made.get(extra, {}) for extra in extras):
        for name, archive in others.items():  # it may change without its name
            if oci.push_archive(archive(), shorten_name(name), state.layout.registry):
                report(f"Adding {name} to the registry")
        remember(state, (), others)


def remember(state: State, extras: Iterable[str], offers: Iterable[str]) -> None:
    """Note what the registry offers now."""
    state.extras = sorted({*state.extras, *extras})
    state.offers = sorted({*state.offers, *offers})
    state.save()


def push_images(layout: Layout, images: Iterable[oci.Image], seconds: float = 30) -> None:
    """Put images into the cluster's registry, as soon as that listens.

    Raises:
        LocalClusterError: it does not within the time, or it refused one.
    """
    deadline = time.monotonic() + seconds
    for image in images:
        while True:
            try:
                oci.push(image, layout.registry)
                break
            except urllib3.exceptions.HTTPError as error:
                if time.monotonic() > deadline:
                    raise LocalClusterError(
                        f"the registry {layout.registry} does not answer: {error}",
                        hint=f"its log: {layout.directory}/control-plane/logs/registry.log",
                    ) from error
                time.sleep(0.1)

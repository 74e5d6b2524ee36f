"""What a cluster offers on request: images under their upstream names, for nodes to pull.

None of it is installed here. An image has the programs, paths and start of upstream's image of that
name, so that upstream's manifests run unchanged; its shell and tools are busybox. The images of an
observability stack are in `observability_images`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from rigel_lab.cluster.components import MULTUS, PLUGINS, WHEREABOUTS, Components
from rigel_lab.cluster.observability_images import OBSERVABILITY_IMAGES, OPERATOR_IMAGES
from rigel_lab.cluster.oci import Image
from rigel_lab.cluster.upstream import find_program, shell, shorten_name, text, tools, users

ORGANISATION = "ghcr.io/k8snetworkplumbingwg"
MULTUS_IMAGE = f"{ORGANISATION}/multus-cni:v{MULTUS.version}-thick"
WHEREABOUTS_IMAGE = f"{ORGANISATION}/whereabouts:v{WHEREABOUTS.version}"
#: The project of the standard CNI programs has no image; k3s' documentation uses this one.
PLUGINS_IMAGE = f"docker.io/rancher/hardened-cni-plugins:v{PLUGINS.version}-build20260608"


def list_offered(extras: Iterable[str]) -> list[str]:
    """Return the names under which nodes pull the requested images."""
    return [name for extra in extras for name in EXTRAS[extra]]


def extra_images(components: Components, extras: Iterable[str]) -> list[Image]:
    """Return the requested images."""
    return [make(components) for extra in extras for make in EXTRAS[extra].values()]


def multus(components: Components) -> Image:
    """Return Multus' image, the thick one.

    Of upstream's only what certificates of the thin plugin need is left out.
    """
    programs = "usr/src/multus-cni/bin"
    return image(
        components,
        MULTUS_IMAGE,
        {f"{programs}/{name}": find_program(components, name) for name in MULTUS.program_names}
        | {"usr/src/multus-cni/LICENSE": text(components, "multus-license")},
        entrypoint=[f"/{programs}/multus-daemon"],
    )


def whereabouts(components: Components) -> Image:
    """Return whereabouts' image; its scripts are those of its module."""
    names = [*WHEREABOUTS.program_names, "install-cni.sh", "lib.sh", "token-watcher.sh"]
    return image(
        components,
        WHEREABOUTS_IMAGE,
        {name: find_program(components, name) for name in names}
        | {"LICENSE": text(components, "whereabouts-license")},
        command=["/install-cni.sh"],
    )


def plugins(components: Components) -> Image:
    """Return an image of the standard CNI programs, without Rancher's `flannel` and `bond`."""
    script = Path(__file__).with_name("install-cnis.sh")
    return image(
        components,
        PLUGINS_IMAGE,
        {f"opt/cni/bin/{name}": find_program(components, name) for name in PLUGINS.program_names}
        | {"install-cnis.sh": script, "LICENSE": text(components, "cni-plugins-license")},
        entrypoint=["/install-cnis.sh"],
    )


def image(
    components: Components, name: str, files: Mapping[str, Path | str], **start: Sequence[str]
) -> Image:
    """Return an image with a shell and its tools, for a name of upstream's."""
    return Image(
        shorten_name(name),
        # Without its user Multus' daemon ends with a nil pointer.
        {**users(), **shell(components), **files},
        start.get("entrypoint", ()),
        # The network namespaces of a node are in /var/run for some, in /run for others.
        links=tools(components) | {"var/run": "/run"},
        command=start.get("command", ()),
    )


#: What `--with` can request: what nodes pull -> what makes it. A kubectl is for people.
EXTRAS: Mapping[str, Mapping[str, Callable[[Components], Image]]] = {
    "kubectl": {},
    "multus": {
        MULTUS_IMAGE: multus,
        WHEREABOUTS_IMAGE: whereabouts,
        PLUGINS_IMAGE: plugins,
    },
    "observability": OBSERVABILITY_IMAGES,
    "prometheus-operator": OPERATOR_IMAGES,
}

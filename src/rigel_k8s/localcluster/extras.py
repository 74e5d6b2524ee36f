"""What a cluster offers on request: images under their upstream names, for nodes to pull.

Nothing of it is installed here. An image has the programs, paths and start of upstream's image of
that name, so that upstream's manifests run unchanged; its shell and tools are busybox.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from rigel_k8s.localcluster.components import MULTUS, WHEREABOUTS, Components
from rigel_k8s.localcluster.oci import Image

__all__ = ["EXTRAS", "extra_images", "offered"]

#: What can be asked for (`--with`).
EXTRAS = ("multus",)

ORGANISATION = "k8snetworkplumbingwg"
MULTUS_IMAGE = f"{ORGANISATION}/multus-cni:v{MULTUS.version}-thick"
WHEREABOUTS_IMAGE = f"{ORGANISATION}/whereabouts:v{WHEREABOUTS.version}"

#: Without its user Multus' daemon ends in a nil pointer.
USERS = {
    "etc/passwd": "root:x:0:0:root:/root:/bin/sh\n",
    "etc/group": "root:x:0:\n",
}


def offered(extras: Iterable[str]) -> list[str]:
    """Return the names under which nodes pull what was asked for."""
    names = {"multus": [MULTUS_IMAGE, WHEREABOUTS_IMAGE]}
    return [f"ghcr.io/{image}" for extra in extras for image in names[extra]]


def extra_images(components: Components, extras: Iterable[str]) -> list[Image]:
    """Return the images of what was asked for."""
    makers: Mapping[str, Callable[[Components], list[Image]]] = {"multus": multus}
    return [image for extra in extras for image in makers[extra](components)]


def multus(components: Components) -> list[Image]:
    """Return the images of Multus (thick) and whereabouts.

    Of upstream's image of Multus only what the thin plugin's certificates need is left out.
    """
    programs = "usr/src/multus-cni/bin"
    shell = busybox(components)
    licence = Path(components.program("multus-license")).read_text()
    thick = Image(
        MULTUS_IMAGE,
        {
            **USERS,
            **{f"{programs}/{name}": found(components, name) for name in MULTUS.program_names},
            "usr/src/multus-cni/LICENSE": licence,
            "bin/busybox": found(components, "busybox"),
        },
        [f"/{programs}/multus-daemon"],
        # A node's network namespaces are in /var/run for some, in /run for others.
        links=shell | {"var/run": "/run"},
    )
    names = [*WHEREABOUTS.program_names, "install-cni.sh", "lib.sh", "token-watcher.sh"]
    addresses = Image(
        WHEREABOUTS_IMAGE,
        {
            **USERS,
            **{name: found(components, name) for name in names},
            "LICENSE": Path(components.program("whereabouts-license")).read_text(),
            "bin/busybox": found(components, "busybox"),
        },
        [],
        command=["/install-cni.sh"],
        links=shell | {"var/run": "/run"},
    )
    return [thick, addresses]


def found(components: Components, name: str) -> Path:
    """Return a program of the cluster's."""
    return Path(components.program(name))


def busybox(components: Components) -> dict[str, str]:
    """Return a link to busybox for each of its tools."""
    program = components.program("busybox")
    listed = subprocess.run([program, "--list"], capture_output=True, text=True, check=True)
    return {f"bin/{tool}": "busybox" for tool in listed.stdout.split() if tool != "busybox"}

"""What a local cluster runs beside Kubernetes: DNS, a default StorageClass, their images."""

from __future__ import annotations

from pathlib import Path
from string import Template
from typing import Any

import yaml

from rigel_lab.cluster.components import Components
from rigel_lab.cluster.layout import Layout
from rigel_lab.cluster.oci import Image

#: (namespace, name) of what must be ready before a cluster is.
DEPLOYMENTS = (("kube-system", "coredns"), ("local-path-storage", "local-path-provisioner"))

Object = dict[str, Any]


def images(components: Components) -> list[Image]:
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


def objects(layout: Layout) -> list[Object]:
    """Return the manifests, in the order in which they can be applied."""
    servers = (layout.directory / "node1" / "resolv.conf").read_text()
    text = Template(Path(__file__).with_name("addons.yaml").read_text("utf-8")).substitute(
        registry=layout.registry,
        dns=layout.addresses.dns_service,
        forward="forward . /etc/resolv.conf" if servers else "",
    )
    return list(yaml.safe_load_all(text))

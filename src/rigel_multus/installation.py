"""Multus and whereabouts on one cluster: what it has, and what this program installs; pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import attrs

from rigel_k8s.network.options import Install
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.types import ReleaseId
from rigel_multus.platform import Group

Object = Mapping[str, Any]
Part = Literal["multus", "whereabouts"]
PARTS: Sequence[Part] = ("multus", "whereabouts")

#: Usual names of a part's DaemonSet, and of its image.
NAMES = {
    "multus": ("multus", "kube-multus-ds", "rigel-multus"),
    "whereabouts": ("whereabouts", "rigel-whereabouts"),
}
IMAGES = {"multus": ("multus", "multus-cni"), "whereabouts": ("whereabouts",)}
#: Multus and whereabouts are a release of their own, shared by all applications.
RELEASE = ReleaseId("kube-system", "rigel-network")

MULTUS_IMAGE = "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick"
WHEREABOUTS_IMAGE = "ghcr.io/k8snetworkplumbingwg/whereabouts:v0.9.4"
#: The standard CNI programs, for clusters whose own set has no macvlan.
PLUGINS_IMAGE = "docker.io/rancher/hardened-cni-plugins:v1.9.1-build20260608"


@attrs.frozen
class Presence:
    """Multus or whereabouts on the cluster: one DaemonSet or several.

    Attributes:
        ours: whether it is part of the release that this program installs.
    """

    sets: tuple[Object, ...]
    ours: bool

    @property
    def where(self) -> str:
        """Return its first DaemonSet, for people."""
        meta = self.sets[0]["metadata"]
        return f"{meta['namespace']}/{meta['name']}"

    @property
    def image(self) -> str:
        return str(self.sets[0]["spec"]["template"]["spec"]["containers"][0]["image"])


@attrs.frozen
class Installation:
    """Multus and whereabouts on a cluster.

    Attributes:
        groups: its Linux machines by platform; those that join later belong to the first.
        options: completed by those of earlier installations.
        nodes: all its machines.
        parts: the parts that it has.
        foreign: names of our CustomResourceDefinitions that others have made: they stay unchanged.
        retired: remove what was put onto the machines; the objects are deleted after that.
    """

    groups: Sequence[Group]
    options: Install = attrs.field(factory=Install)
    nodes: Sequence[Object] = ()
    parts: Mapping[Part, Presence] = attrs.field(factory=dict)
    foreign: frozenset[str] = frozenset()
    retired: bool = False

    @property
    def installs(self) -> list[Part]:
        """The parts that this program installs; those of others are used unchanged."""
        return [part for part in PARTS if part not in self.parts or self.parts[part].ours]

    @property
    def linux(self) -> list[Object]:
        names = {name for group in self.groups for name in group.nodes}
        return [node for node in self.nodes if node["metadata"]["name"] in names]

    @property
    def up(self) -> list[Object]:
        """Those that are up; unreachable ones are not waited for."""
        return [node for node in self.linux if is_ready(node)]

    @property
    def away(self) -> tuple[str, ...]:
        """The names of those that are not up."""
        return tuple(sorted(n["metadata"]["name"] for n in self.linux if not is_ready(n)))


def find_parts(sets: Sequence[Object]) -> dict[Part, Presence]:
    """Return the parts that a cluster has, from its DaemonSets; ours come first."""
    parts: dict[Part, Presence] = {}
    for part in PARTS:
        running = tuple(one for one in sets if runs(part, one))
        ours = tuple(one for one in running if is_ours(one))
        if running:
            parts[part] = Presence(ours or running, bool(ours))
    return parts


def runs(part: Part, daemon_set: Object) -> bool:
    """Return whether a DaemonSet runs a part, judged by its name and its images."""
    if daemon_set["metadata"]["name"] in NAMES[part]:
        return True
    if is_ours(daemon_set):
        return bool(daemon_set["metadata"]["name"].startswith(f"rigel-{part}-"))
    spec = daemon_set["spec"]["template"]["spec"]
    if not any("cni" in v.get("hostPath", {}).get("path", "") for v in spec.get("volumes", [])):
        return False  # the image is used for something else
    return any(is_image(one.get("image", ""), IMAGES[part]) for one in spec.get("containers", []))


def is_image(image: str, names: Iterable[str]) -> bool:
    """Return whether an image is one of these; hardened and mirrored ones count too."""
    last = image.partition("@")[0].rpartition("/")[2].partition(":")[0]
    return any(last == name or last.endswith(f"-{name}") for name in names)


def is_ours(live: Object) -> bool:
    """Return whether an object is part of the release that this program installs."""
    meta = live["metadata"]
    label = (meta.get("labels") or {}).get(RELEASE_LABEL)
    return bool(label == RELEASE.name and meta.get("namespace") == RELEASE.namespace)

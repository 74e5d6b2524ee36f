"""Which parts of Multus and whereabouts a cluster has, and who installed them; only reads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.definitions import attachment_definition, whereabouts_definitions
from rigel_k8s.network.multus.recognition import Group, groups
from rigel_k8s.network.options import Install
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.deploy import find_last_good
from rigel_k8s.release.survey import belongs

Object = Mapping[str, Any]

NAMES = {
    "multus": ("multus", "kube-multus-ds", "rigel-multus"),
    "whereabouts": ("whereabouts", "rigel-whereabouts"),
}
IMAGES = {"multus": ("multus", "multus-cni"), "whereabouts": ("whereabouts",)}


@attrs.frozen
class MultusPresence:
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
        """Return its image."""
        return str(self.sets[0]["spec"]["template"]["spec"]["containers"][0]["image"])


@attrs.frozen
class Found:
    """A cluster before something is installed.

    Attributes:
        nodes: all its machines.
        groups: its Linux machines by platform.
        multus: None if it is not installed.
        whereabouts: None if it is not installed.
        definitions: names of our kinds that others have defined.
    """

    nodes: tuple[Object, ...]
    groups: tuple[Group, ...]
    multus: MultusPresence | None
    whereabouts: MultusPresence | None
    definitions: frozenset[str]

    @property
    def up(self) -> tuple[str, ...]:
        """The names of the machines that are up; unreachable ones are not waited for."""
        known = {name for group in self.groups for name in group.nodes}
        return tuple(
            sorted(
                n["metadata"]["name"]
                for n in self.nodes
                if n["metadata"]["name"] in known and is_ready(n)
            )
        )

    @property
    def away(self) -> tuple[str, ...]:
        """The names of the machines that are not up."""
        known = {name for group in self.groups for name in group.nodes}
        return tuple(sorted(known - set(self.up)))


def find(cluster: Cluster, options: Install) -> Found:
    """Look at a cluster.

    Raises:
        ClusterError: we may not read it, or it has no Linux machine.
    """
    nodes = cluster.nodes()
    sorted_out = groups(nodes, options)
    if not sorted_out:
        raise ClusterError("cannot install Multus: the cluster has no Linux machine")
    sets = cluster.list("apps/v1", "DaemonSet")
    return Found(
        tuple(nodes),
        sorted_out,
        _part("multus", sets),
        _part("whereabouts", sets),
        _definitions(cluster),
    )


def complete_options(cluster: Cluster, given: Install) -> Install:
    """Return options in which those that are not set have the values of the last installation.

    Several Rigelfiles share a cluster's network: one with `install: true` must not revert the
    images and directories that another has set.
    """
    last = find_last_good(cluster, RELEASE)
    before = dict(last.options) if last else {}
    new = attrs.asdict(given, filter=lambda _, value: value is not None)
    return Install(**{**before, **new})


def _part(name: str, sets: Iterable[Object]) -> MultusPresence | None:
    """Return the installed Multus or whereabouts, None if it is missing; ours comes first."""
    found = [one for one in sets if _is(name, one)]
    ours = tuple(one for one in found if _is_ours(one))
    if ours:
        return MultusPresence(ours, ours=True)
    return MultusPresence(tuple(found), ours=False) if found else None


def _is(name: str, daemon_set: Object) -> bool:
    """Return whether a DaemonSet runs this part, judged by its name and its images."""
    if daemon_set["metadata"]["name"] in NAMES[name]:
        return True
    if _is_ours(daemon_set):
        return bool(daemon_set["metadata"]["name"].startswith(f"rigel-{name}-"))
    spec = daemon_set["spec"]["template"]["spec"]
    if not any("cni" in v.get("hostPath", {}).get("path", "") for v in spec.get("volumes", [])):
        return False  # the image is used for something else
    containers = spec.get("containers", [])
    return any(_names(container.get("image", ""), IMAGES[name]) for container in containers)


def _names(image: str, names: Iterable[str]) -> bool:
    """Return whether an image is one of these; hardened and mirrored ones count too."""
    last = image.partition("@")[0].rpartition("/")[2].partition(":")[0]
    return any(last == name or last.endswith(f"-{name}") for name in names)


def _is_ours(live: Object) -> bool:
    meta = live["metadata"]
    label = (meta.get("labels") or {}).get(RELEASE_LABEL)
    return bool(label == RELEASE.name and meta.get("namespace") == RELEASE.namespace)


def _definitions(cluster: Cluster) -> frozenset[str]:
    names = [
        definition["metadata"]["name"]
        for definition in (attachment_definition(), *whereabouts_definitions())
    ]
    refs = [
        ObjectRef("apiextensions.k8s.io/v1", "CustomResourceDefinition", "", name) for name in names
    ]
    there = zip(names, cluster.parallel(cluster.get, refs), strict=True)
    return frozenset(name for name, live in there if live and not belongs(live, RELEASE))

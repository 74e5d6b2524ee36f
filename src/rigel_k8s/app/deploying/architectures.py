"""Whether the machines that may run a workload have an architecture of its images.

It is checked with the dry runs of a deploy, for workloads that change. If a registry or the
cluster gives no answer, the deploy continues: the container runtime may then refuse the image.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rigel_k8s.app.deploying.places import fits
from rigel_k8s.errors import ClusterError
from rigel_k8s.image_reference import parse_reference
from rigel_k8s.images.credentials import RegistryCredentials, credentials_for
from rigel_k8s.images.registry import find_architectures
from rigel_k8s.objects.images import containers, images_of
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

ARCHITECTURE = "kubernetes.io/arch"
#: Architectures by image; unknown images are not in it.
Architectures = Mapping[str, frozenset[str]]


def find_unfit_machines(
    workloads: Sequence[Manifest], cluster: Cluster, known: Sequence[RegistryCredentials]
) -> dict[ObjectRef, str]:
    """Return why no machine can run a workload, by workload.

    Args:
        known: users of registries.
    """
    try:
        nodes = cluster.nodes()
    except ClusterError:
        return {}
    images = [image for image in images_of(workloads) if "@" in image]

    def ask(image: str) -> frozenset[str]:
        return find_architectures(image, credentials_for(parse_reference(image).registry, known))

    answers = zip(images, cluster.parallel(ask, images), strict=True)
    found = {image: architectures for image, architectures in answers if architectures}
    return dict(explain(workloads, nodes, found))


def explain(
    workloads: Iterable[Manifest], nodes: Sequence[Mapping[str, Any]], found: Architectures
) -> Iterator[tuple[ObjectRef, str]]:
    """Yield each workload whose machines are all of another architecture, and why; pure."""
    for workload in workloads:
        selector = workload["spec"]["template"]["spec"].get("nodeSelector") or {}
        machines = [read_architecture(node) for node in nodes if fits(selector, node)]
        if not machines or "" in machines:
            continue
        for image in dict.fromkeys(c["image"] for c in containers(workload)):
            runs_on = found.get(image)
            if runs_on and not runs_on & set(machines):
                yield ref_of(workload), describe(image, runs_on, machines, chosen=bool(selector))
                break


def describe(image: str, runs_on: Iterable[str], machines: Iterable[str], *, chosen: bool) -> str:
    """Return what does not fit."""
    which = "the machines that its placement allows are" if chosen else "the cluster's machines are"
    return (
        f"{image.partition('@')[0]} runs on {', '.join(sorted(runs_on))}, but {which}"
        f" {', '.join(sorted(set(machines)))}"
    )


def read_architecture(node: Mapping[str, Any]) -> str:
    """Return a machine's architecture, "" if it is unknown."""
    return str((node["metadata"].get("labels") or {}).get(ARCHITECTURE, ""))

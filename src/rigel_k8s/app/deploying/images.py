"""Whether the images of a release exist, for an architecture of the machines that may run them.

It is checked with the dry runs of a deploy, for workloads that change. If a registry or the
cluster gives no answer, the deploy continues: the container runtime may then refuse the image.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import attrs

from rigel_k8s.image_reference import parse_reference
from rigel_k8s.images.credentials import RegistryCredentials, credentials_for
from rigel_k8s.images.registry import find_architectures
from rigel_k8s.objects.images import containers, images_of, list_loaded
from rigel_k8s.objects.refs import Manifest, ref_of
from rigel_k8s.objects.scheduling import may_run
from rigel_k8s.release.types import Obstacle

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

ARCHITECTURE = "kubernetes.io/arch"
#: How many images a kubelet reports: one with as many may have more.
REPORTED = 50
#: Architectures by image; unknown images are not in it.
Architectures = Mapping[str, frozenset[str]]


@attrs.frozen
class Images:
    """The images of a release, and who may read them.

    Attributes:
        known: users of registries.
        unknown: images that their registries do not have.
    """

    cluster: Cluster
    known: Sequence[RegistryCredentials] = ()
    unknown: frozenset[str] = frozenset()

    def find_obstacles(
        self, workloads: Sequence[Manifest], nodes: Sequence[Manifest]
    ) -> Iterator[Obstacle]:
        """Yield why the images of workloads cannot run on the machines."""
        yield from find_absent(workloads, nodes, self.unknown)
        if nodes:
            images = [image for image in images_of(workloads) if "@" in image]
            answers = zip(images, self.cluster.parallel(self.ask, images), strict=True)
            found = {image: architectures for image, architectures in answers if architectures}
            yield from find_unfit(workloads, nodes, found)

    def ask(self, image: str) -> frozenset[str]:
        """Return the architectures of an image; none if they are unknown."""
        user = credentials_for(parse_reference(image).registry, self.known)
        return find_architectures(image, user)


def find_absent(
    workloads: Iterable[Manifest], nodes: Sequence[Manifest], unknown: frozenset[str]
) -> Iterator[Obstacle]:
    """Yield workloads with an image that no registry has, and no machine either; pure.

    An image may have been loaded onto machines. Which ones those have is known only if each of them
    reports fewer than it may.
    """
    sure = bool(nodes) and all(
        len((node.get("status") or {}).get("images") or ()) < REPORTED for node in nodes
    )
    loaded = list_loaded(nodes)
    for workload in workloads:
        for container in containers(workload):
            image, policy = container["image"], container.get("imagePullPolicy")
            if image not in unknown or policy == "Never":
                continue
            reference = parse_reference(image)
            if policy == "Always" or (sure and str(reference) not in loaded):
                text = f"the registry {reference.registry} does not have the image {image}"
                yield Obstacle(ref_of(workload), text, "no-image")
                break


def find_unfit(
    workloads: Iterable[Manifest], nodes: Sequence[Manifest], found: Architectures
) -> Iterator[Obstacle]:
    """Yield each workload whose machines are all of another architecture; pure."""
    for workload in workloads:
        pod = workload["spec"]["template"]["spec"]
        machines = [read_architecture(node) for node in nodes if may_run(pod, node)]
        if not machines or "" in machines:
            continue
        chosen = len(machines) < len(nodes)
        for image in dict.fromkeys(c["image"] for c in containers(workload)):
            runs_on = found.get(image)
            if runs_on and not runs_on & set(machines):
                text = describe(image, runs_on, machines, chosen=chosen)
                yield Obstacle(ref_of(workload), text, "architecture")
                break


def describe(image: str, runs_on: Iterable[str], machines: Iterable[str], *, chosen: bool) -> str:
    """Return what does not fit."""
    which = "the machines that may run it are" if chosen else "the cluster's machines are"
    return (
        f"{image.partition('@')[0]} runs on {', '.join(sorted(runs_on))}, but {which}"
        f" {', '.join(sorted(set(machines)))}"
    )


def read_architecture(node: Manifest) -> str:
    """Return a machine's architecture, "" if it is unknown."""
    return str((node["metadata"].get("labels") or {}).get(ARCHITECTURE, ""))

"""The images of a release: by digest, on the machines that may run them, and who may pull them.

By digest a rebuilt tag is rolled out, and is the same everywhere. Whether images exist, and for an
architecture of the machines, is checked with the dry runs of a deploy, for workloads that change;
if a registry or the cluster gives no answer, the deploy continues: the container runtime may then
refuse the image. The pods' pull secret is not in revisions and renders: it is written separately,
and has the release's label, so that `down` finds it.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s.image_reference import parse_reference
from rigel_k8s.images.credentials import RegistryCredentials, credentials_for, docker_config
from rigel_k8s.images.registry import DIGESTS, find_architectures, look_up
from rigel_k8s.objects.images import containers, images_of, list_loaded
from rigel_k8s.objects.naming import labels
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.scheduling import may_run
from rigel_k8s.release.apply import make_namespace
from rigel_k8s.release.types import Desired, Obstacle, ReleaseId

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

ARCHITECTURE = "kubernetes.io/arch"
#: How many images a kubelet reports: one with as many may have more.
REPORTED = 50
#: Architectures by image; unknown images are not in it.
Architectures = Mapping[str, frozenset[str]]


@attrs.frozen
class Pinned:
    """Which images a release runs.

    Attributes:
        by_digest: image to image@digest, of those whose digest is known.
        unknown: those that their registries do not have, and no earlier revision had.
    """

    by_digest: Mapping[str, str]
    unknown: frozenset[str] = frozenset()


def pin(
    images: Sequence[str],
    data: Mapping[str, Any],
    credentials: Sequence[RegistryCredentials],
    last_objects: Callable[[], Iterable[Manifest]],
) -> Pinned:
    """Return the images with their digests.

    The sources, in this order: a push of this run, the image's registry, the last revision. An
    image of the nodes' own (loaded, never pushed) has none and stays as it is.
    """
    digests = find_pushed(images, data)
    rest = [image for image in images if image not in digests and "@" not in image]
    answers = look_up(rest, credentials)
    digests |= answers.digests
    found = {image: f"{image}@{digest}" for image, digest in digests.items()}
    rest = [image for image in rest if image not in found]
    if rest:
        pinned = (image for image in images_of(last_objects()) if "@" in image)
        last = {image.partition("@")[0]: image for image in pinned}
        found |= {image: last[image] for image in rest if image in last}
    return Pinned(found, answers.unknown - found.keys())


def find_pushed(images: Sequence[str], data: Mapping[str, Any]) -> dict[str, str]:
    """Return the digests of images that this run pushed; `app` is docker.io/library/app:latest."""
    known = data.get(DIGESTS)
    if not isinstance(known, Mapping):
        return {}
    by_name = {complete_name(image): str(digest) for image, digest in known.items()}
    names = {image: complete_name(image) for image in images if "@" not in image}
    return {image: by_name[name] for image, name in names.items() if name in by_name}


def complete_name(image: str) -> str:
    """Return an image's full name, with its tag."""
    reference = parse_reference(image)
    return f"{reference.name}:{reference.tag or 'latest'}"


@attrs.frozen
class Images:
    """The images of a release, looked at before its first write, and who may read them.

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
        able = [node["metadata"].get("labels") or {} for node in nodes if may_run(pod, node)]
        machines = [str(known.get(ARCHITECTURE, "")) for known in able]
        if not machines or "" in machines:
            continue
        which = "the cluster's machines are"
        if len(machines) < len(nodes):
            which = "the machines that may run it are"
        for image in dict.fromkeys(c["image"] for c in containers(workload)):
            runs_on = found.get(image)
            if runs_on and not runs_on & set(machines):
                text = (
                    f"{image.partition('@')[0]} runs on {', '.join(sorted(runs_on))}, but {which}"
                    f" {', '.join(sorted(set(machines)))}"
                )
                yield Obstacle(ref_of(workload), text, "architecture")
                break


def secret_name(release: str) -> str:
    """Return the name of a release's pull secret."""
    return f"{release}-registry"


def has_pull_secret(release: ReleaseId, cluster: Cluster) -> bool:
    """Return whether an earlier run has left a pull secret."""
    ref = ObjectRef("v1", "Secret", release.namespace, secret_name(release.name))
    return cluster.get(ref) is not None


def choose_credentials(
    images: Sequence[str], known: Sequence[RegistryCredentials]
) -> tuple[RegistryCredentials, ...]:
    registries = {parse_reference(image).registry for image in images}
    return tuple(one for one in known if one.username and one.registry in registries)


def secret_of(release: ReleaseId, credentials: Sequence[RegistryCredentials]) -> dict[str, Any]:
    """Return the Secret that the kubelet reads."""
    config = json.dumps(docker_config(credentials), sort_keys=True)
    return {
        "apiVersion": "v1",
        "kind": "Secret",
        "type": "kubernetes.io/dockerconfigjson",
        "metadata": {
            "name": secret_name(release.name),
            "namespace": release.namespace,
            "labels": labels(release.name, release.name),
        },
        "data": {".dockerconfigjson": base64.b64encode(config.encode()).decode()},
    }


def write_pull_secret(
    desired: Desired, credentials: Sequence[RegistryCredentials], cluster: Cluster
) -> None:
    """Write the pull secret before the first pod needs it; nothing if it is unchanged."""
    if not credentials:
        return
    wanted = secret_of(desired.release, credentials)
    live = cluster.get(ref_of(wanted))
    if live is not None and live.get("data") == wanted["data"]:
        return
    if desired.create_namespace:
        make_namespace(cluster, desired.release.namespace)
    cluster.apply(wanted)

"""Images by digest, so that a rebuilt tag is rolled out, and is the same everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.image_reference import parse_reference
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.images.registry import DIGESTS, resolve_digests
from rigel_k8s.objects.images import images_of

Manifests = Iterable[Mapping[str, Any]]


def pins(
    images: Sequence[str],
    data: Mapping[str, Any],
    credentials: Sequence[RegistryCredentials],
    last_objects: Callable[[], Manifests],
) -> dict[str, str]:
    """Return {image: image@digest} for the images whose digest is known.

    The sources, in this order: a push of this run, the image's registry, the last revision. An
    image of the nodes' own (loaded, never pushed) has none and stays as it is.
    """
    digests = dict(_find_pushed(images, data))
    rest = [image for image in images if image not in digests and "@" not in image]
    digests |= resolve_digests(rest, credentials)
    found = {image: f"{image}@{digest}" for image, digest in digests.items()}
    rest = [image for image in rest if image not in found]
    if rest:
        last = dict(_read_revision(last_objects()))
        found |= {image: last[image] for image in rest if image in last}
    return found


def _find_pushed(images: Sequence[str], data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    known = data.get(DIGESTS)
    if not isinstance(known, Mapping):
        return
    by_name = {_complete_name(image): str(digest) for image, digest in known.items()}
    for image in images:
        if "@" not in image and _complete_name(image) in by_name:
            yield image, by_name[_complete_name(image)]


def _complete_name(image: str) -> str:
    """Return an image's full name: `app` is docker.io/library/app:latest."""
    reference = parse_reference(image)
    return f"{reference.name}:{reference.tag or 'latest'}"


def _read_revision(objects: Manifests) -> Iterator[tuple[str, str]]:
    """Yield (image without its digest, the same with it) of a revision's workloads."""
    for image in images_of(objects):
        name, at, _ = image.partition("@")
        if at:
            yield name, image

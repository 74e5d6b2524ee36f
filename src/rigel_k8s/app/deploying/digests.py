"""Images by digest, so that a rebuilt tag is rolled out, and is the same everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.image_reference import parse_reference
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.images.registry import DIGESTS, look_up
from rigel_k8s.objects.images import images_of

Manifests = Iterable[Mapping[str, Any]]


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
    last_objects: Callable[[], Manifests],
) -> Pinned:
    """Return the images with their digests.

    The sources, in this order: a push of this run, the image's registry, the last revision. An
    image of the nodes' own (loaded, never pushed) has none and stays as it is.
    """
    digests = dict(_find_pushed(images, data))
    rest = [image for image in images if image not in digests and "@" not in image]
    answers = look_up(rest, credentials)
    digests |= answers.digests
    found = {image: f"{image}@{digest}" for image, digest in digests.items()}
    rest = [image for image in rest if image not in found]
    if rest:
        last = dict(_read_revision(last_objects()))
        found |= {image: last[image] for image in rest if image in last}
    return Pinned(found, answers.unknown - found.keys())


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

"""The images of what is installed for a whole cluster, by digest: Multus' and the stack's.

A registry is queried once for each image. Later installations keep what the last revision has, so
a tag that is moved upstream changes nothing, and a cluster that cannot reach the registry does not
wait for it. Applications query it at each deploy (`app/deploying/images.py`): their tags are meant
to move.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import attrs

from rigel_k8s.image_reference import parse_reference
from rigel_k8s.images.registry import look_up
from rigel_k8s.objects.images import images_of, list_loaded, pin_images
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.types import Desired, Revision


def pin(
    desired: Desired, last: Revision | None, list_nodes: Callable[[], Iterable[Manifest]]
) -> Desired:
    """Return a release with its images by digest, as far as a registry has the tag's digest.

    If the machines have an image under its tag with another digest, it stays as it is written: it
    was loaded onto them, and no registry has it.

    Args:
        last: the last good revision.
        list_nodes: lists the cluster's nodes; not called if the last revision has all images.
    """
    before = {image.partition("@")[0]: image for image in images_of(last.objects if last else ())}
    images = [image for image in images_of(desired.objects) if "@" not in image]
    pins = {image: before[image] for image in images if image in before}
    new = [image for image in images if image not in before]
    if new:
        pins |= find_pins(new, list_loaded(list_nodes()))
    objects = tuple(pin_images(manifest, pins) for manifest in desired.objects)
    return attrs.evolve(desired, objects=objects)


def find_pins(images: Iterable[str], loaded: frozenset[str]) -> dict[str, str]:
    """Return {image: image@digest} of those in a registry that were not loaded."""
    found = {}
    for image, digest in look_up(images).digests.items():
        reference = parse_reference(image)
        if str(reference) not in loaded or f"{reference.name}@{digest}" in loaded:
            found[image] = f"{image}@{digest}"
    return found

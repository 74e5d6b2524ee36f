"""Images of the stack and of Multus go out by the digest that they had when they were installed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from rigel_k8s.network.options import Install
from rigel_k8s.objects.images import images_of
from rigel_k8s.objects.scalars import ImageRef
from rigel_k8s.observability.options import request_of
from rigel_k8s.pinning import pin
from rigel_k8s.release.types import Desired, ReleaseId, Revision
from rigel_multus.install import find_release
from rigel_multus.installation import Installation
from rigel_multus.platform import Group, platform
from rigel_stack.install import desired_stack
from tests.support.fake_cluster import FakeCluster
from tests.support.tag_registry import DIGEST, TagRegistry, serve_tags

RELEASE = ReleaseId("n", "stack")
OTHER = "sha256:" + "cd" * 32


@pytest.fixture
def registry() -> Iterator[TagRegistry]:
    """A registry that has `app:1`."""
    with serve_tags() as server:
        yield server


def workload(*images: str) -> dict[str, Any]:
    containers = [{"name": f"c{number}", "image": image} for number, image in enumerate(images)]
    spec = {"template": {"spec": {"containers": containers}}}
    return {"apiVersion": "apps/v1", "kind": "Deployment", "metadata": {"name": "w"}, "spec": spec}


def pinned(*images: str, last: tuple[str, ...] = (), nodes: Any = ()) -> tuple[str, ...]:
    """Return the images as they go out."""
    revision = Revision(RELEASE, 1, "good", "", (workload(*last),), ()) if last else None
    desired = pin(Desired(RELEASE, (workload(*images),)), revision, lambda: nodes)
    return images_of(desired.objects)


def has(*names: str) -> Mapping[str, Any]:
    """Return a node that has an image."""
    return {"kind": "Node", "status": {"images": [{"names": list(names)}]}}


def test_a_first_installation_asks_the_registry(registry: TagRegistry) -> None:
    """What the registry does not have stays as it is written."""
    known, unknown = f"{registry.host}/app:1", f"{registry.host}/app:2"
    assert pinned(known, unknown) == (f"{known}@{DIGEST}", unknown)


def test_a_tag_that_is_moved_changes_nothing(registry: TagRegistry) -> None:
    """The last revision has the digest, so no one is asked."""
    name = f"{registry.host}/app:1"
    last = pinned(name)
    registry.digest, registry.asked = OTHER, 0
    assert pinned(name, last=last) == last
    assert registry.asked == 0


def test_what_went_out_by_tag_stays_so(registry: TagRegistry) -> None:
    """A cluster without a way to the registry does not restart its pods when there is one."""
    name = f"{registry.host}/app:1"
    assert pinned(name, last=(name,)) == (name,)


def test_a_digest_in_the_options_wins(registry: TagRegistry) -> None:
    name = f"{registry.host}/app:1@{OTHER}"
    assert pinned(name, last=(f"{registry.host}/app:1@{DIGEST}",)) == (name,)
    assert registry.asked == 0


def test_an_image_that_was_loaded_onto_the_machines_stays(registry: TagRegistry) -> None:
    """A machine that cannot pull would not find it by the registry's digest."""
    name = f"{registry.host}/app"
    assert pinned(f"{name}:1", nodes=[has(f"{name}:1", f"{name}@{OTHER}")]) == (f"{name}:1",)
    same = [has(f"{name}:1", f"{name}@{DIGEST}")]
    assert pinned(f"{name}:1", nodes=same) == (f"{name}:1@{DIGEST}",)


def test_the_stack_and_multus_are_pinned(registry: TagRegistry, fake: FakeCluster) -> None:
    """Both ask for the images that their options name."""
    name = f"{registry.host}/app:1"
    said = {"loki": {"image": name}, "otel_collector": {"image": name}}
    parts = ("prometheus", "kube_state_metrics", "grafana")
    stack = desired_stack(request_of(said | {part: {"image": name} for part in parts}), fake)
    assert set(images_of(stack.desired.objects)) == {f"{name}@{DIGEST}"}
    image = ImageRef(name)
    install = Install(multus_image=image, whereabouts_image=image, plugins_image=image)
    for retired in (False, True):
        installation = Installation([Group(platform("plain"))], install, retired=retired)
        assert set(images_of(find_release(fake, installation).objects)) == {f"{name}@{DIGEST}"}

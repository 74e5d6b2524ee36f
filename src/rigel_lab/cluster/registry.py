"""What is put into a running cluster's registry: images of its own, and requested ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import attrs
import urllib3

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster import components, oci
from rigel_lab.cluster.commands import Report
from rigel_lab.cluster.extras import extra_images, list_offered, shorten_name
from rigel_lab.cluster.layout import Layout
from rigel_lab.cluster.state import State

#: Images that others make for an extra: extra -> name under which nodes pull it -> what makes the
#: archive, or finds it made.
Made = Mapping[str, Mapping[str, Callable[[], Path]]]


def offer(state: State, extras: Sequence[str], made: Made, report: Report) -> None:
    """Put what a cluster does not offer yet into its registry, which keeps it."""
    offers = list_offered(extras)
    if not components.names(extras) <= state.components.go.keys():
        parts = components.obtain(report, extras).go
        # The programs of a running cluster stay as they are, also for a newer rigel.
        state.components = attrs.evolve(state.components, go=parts | state.components.go)
        remember(state, extras, ())
    if not set(offers) <= set(state.offers):
        report(f"Adding {', '.join(extras)} to the registry")
        push_images(state.layout, extra_images(state.components, extras))
        remember(state, extras, offers)
    for extra in extras:
        offer_made(state, made.get(extra, {}), report)


def offer_made(state: State, made: Mapping[str, Callable[[], Path]], report: Report) -> None:
    """Add what others make; it may change without its name."""
    for name, archive in made.items():
        if oci.push_archive(archive(), shorten_name(name), state.layout.registry):
            report(f"Adding {name} to the registry")
    remember(state, (), made)


def remember(state: State, extras: Iterable[str], offers: Iterable[str]) -> None:
    """Note what the registry offers now."""
    state.extras = sorted({*state.extras, *extras})
    state.offers = sorted({*state.offers, *offers})
    state.save()


def push_images(layout: Layout, images: Iterable[oci.Image], seconds: float = 30) -> None:
    """Put images into the cluster's registry, as soon as that listens.

    Raises:
        LocalClusterError: it does not within the time, or it refused one.
    """
    deadline = time.monotonic() + seconds
    for image in images:
        while True:
            try:
                oci.push(image, layout.registry)
                break
            except urllib3.exceptions.HTTPError as error:
                if time.monotonic() > deadline:
                    raise LocalClusterError(
                        f"the registry {layout.registry} does not answer: {error}",
                        hint=f"its log: {layout.directory}/control-plane/logs/registry.log",
                    ) from error
                time.sleep(0.1)

"""Every mode's objects and wirings have a golden file; a changed wiring restarts robots."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from tests.support.golden import Golden

from .shapes import GOLDEN, make_objects, plan

CASES = sorted(path.name.removesuffix(".case.yaml") for path in GOLDEN.glob("*.case.yaml"))


def make(case: str) -> Iterable[Any]:
    """Return the objects and wirings of a case."""
    return make_objects(plan((GOLDEN / f"{case}.case.yaml").read_text("utf-8")))


FOLDER = Golden(
    GOLDEN,
    make,
    ("macvlan-jazzy", "peers-jazzy", "discovery-server", "zenoh", "host-jazzy"),
    CASES,
)


@pytest.mark.parametrize("case", CASES)
def test_networks_are_those_of_the_golden_file(case: str, *, update_golden: bool) -> None:
    """The same options give the same objects and wirings, to the last field."""
    FOLDER.compare(case, update=update_golden)


def test_golden_files_have_their_case() -> None:
    """No golden file outlives its case."""
    golden = {path.stem for path in GOLDEN.glob("*.yaml") if ".case" not in path.name}
    assert golden == set(CASES)

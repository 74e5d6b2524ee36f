"""Options that all tests share."""

from __future__ import annotations

import os

import pytest

from .lanes import BUILDS, lane_of


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        default=os.environ.get("UPDATE_GOLDEN") == "1",
        help="write golden files anew instead of comparing with them",
    )


def pytest_itemcollected(item: pytest.Item) -> None:
    """Put each test into its lane, before xdist looks for them."""
    item.add_marker(pytest.mark.xdist_group(lane_of(item.path)))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the first test of each lane wait for builds."""
    for first in {lane_of(item.path): item for item in reversed(items)}.values():
        first.add_marker(pytest.mark.timeout(BUILDS))


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether golden files are to be written (also by UPDATE_GOLDEN=1)."""
    return bool(request.config.getoption("--update-golden"))

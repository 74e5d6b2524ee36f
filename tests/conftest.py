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


@pytest.hookimpl(tryfirst=True)  # xdist reads the lanes in its own
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    seen = set()
    for item in items:
        lane = lane_of(item.path)
        item.add_marker(pytest.mark.xdist_group(lane))
        if lane not in seen:
            item.add_marker(pytest.mark.timeout(BUILDS))
        seen.add(lane)


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether golden files are to be written (also by UPDATE_GOLDEN=1)."""
    return bool(request.config.getoption("--update-golden"))

"""Options that all tests share."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest

from .lanes import BUILDS, LANES, Lanes, lane_of

pytest.register_assert_rewrite("tests.support")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        default=os.environ.get("UPDATE_GOLDEN") == "1",
        help="write golden files anew instead of comparing with them",
    )


def pytest_configure() -> None:
    """Let Ctrl-C be heard: what shells start in the background ignores it, with its children."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Lanes:
    config.option.loadscopereorder = False  # the lanes of clusters, which take longest, come first
    return Lanes(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let the first test of each named lane wait for builds, and compare machines last.

    What a machine is like must not change because clusters beside it start.
    """
    items.sort(key=lambda item: item.nodeid.startswith("tests/cluster/lab/"))
    firsts = {lane_of(item.nodeid): item for item in reversed(items)}
    for lane in firsts.keys() & set(LANES.values()):
        firsts[lane].add_marker(pytest.mark.timeout(BUILDS))


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether golden files are to be written (also by UPDATE_GOLDEN=1)."""
    return bool(request.config.getoption("--update-golden"))

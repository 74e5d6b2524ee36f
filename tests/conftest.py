"""What all tests share: options, the order in which they run, and what a run says at its end."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.register_assert_rewrite("tests.support")  # before it is imported

from .lanes import AFTER, Lanes, lane_of, turn_of  # noqa: E402
from .proof import is_proof  # noqa: E402
from .skips import find_unexpected  # noqa: E402
from .support import shared  # noqa: E402


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--update-golden",
        action="store_true",
        default=os.environ.get("UPDATE_GOLDEN") == "1",
        help="write golden files anew instead of comparing with them",
    )
    parser.addoption(
        "--all",
        action="store_true",
        help="also run the tests that are marked `slow` or `timing`",
    )
    parser.addoption(
        "--again",
        type=Path,
        help="run the tests whose ids this JSON file lists; of a story also those before",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Let Ctrl-C be heard: what shells start in the background ignores it, with its children."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if not is_worker(config):
        shared.begin(clusters=may_use_clusters(config))


def may_use_clusters(config: pytest.Config) -> bool:
    """Return whether the run may have tests on a cluster, as far as its arguments show it."""
    unit = [Path(argument).parts[:2] == ("tests", "unit") for argument in config.args]
    return "not cluster" not in config.option.markexpr and not all(unit)


def is_worker(config: pytest.Config) -> bool:
    """Return whether xdist started this process."""
    return hasattr(config, "workerinput")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Lanes:
    config.option.loadscopereorder = False  # ours is the better order
    return Lanes(config, log)


@pytest.hookimpl(tryfirst=True)  # pytest itself puts tests together that share a cluster
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not requested, order the lanes, let the first of each wait for builds."""
    for item in filter(lambda item: is_proof(item.nodeid), items):
        item.add_marker(pytest.mark.proof)
    if not config.getoption("--all"):
        keep(config, items, lambda item: not is_long(item))
    if again := config.getoption("--again"):
        wanted = find_repeated(items, json.loads(again.read_text()))
        keep(config, items, lambda item: item.nodeid in wanted)
    items.sort(key=lambda item: turn_of(item.nodeid))
    firsts = {lane_of(item.nodeid): item for item in reversed(items)}
    for item in firsts.values():
        if item.get_closest_marker("cluster"):
            item.add_marker(pytest.mark.timeout(shared.BUILDS))


def keep(
    config: pytest.Config, items: list[pytest.Item], wanted: Callable[[pytest.Item], bool]
) -> None:
    """Leave out the other tests."""
    config.hook.pytest_deselected(items=[item for item in items if not wanted(item)])
    items[:] = filter(wanted, items)


def is_long(item: pytest.Item) -> bool:
    """Return whether a test runs with `--all` only."""
    return bool(item.get_closest_marker("slow") or item.get_closest_marker("timing"))


def find_repeated(items: Iterable[pytest.Item], failed: Collection[str]) -> set[str]:
    """Return the ids of failed tests, and of the tests of a story that come before one."""
    wanted = set(failed)
    stories: dict[str, list[str]] = {}
    for item in items:
        if item.get_closest_marker("story"):
            told = stories.setdefault(lane_of(item.nodeid), [])
            told.append(item.nodeid)
            if item.nodeid in wanted:
                wanted.update(told)
    return wanted


def pytest_collection_finish(session: pytest.Session) -> None:
    """Start the cluster beside the first tests, where there are tests that use it."""
    first = os.environ.get("PYTEST_XDIST_WORKER", "gw0") == "gw0"
    wanted = any(
        item.get_closest_marker("cluster") and "context" in getattr(item, "fixturenames", ())
        for item in session.items
    )
    if first and wanted and not session.config.option.collectonly and shared.possible():
        threading.Thread(target=shared.start_cluster, daemon=True).start()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Wait for the lane that has to be over, if this run has it."""
    before = AFTER.get(lane_of(item.nodeid))
    if before and any(lane_of(other.nodeid) == before for other in item.session.items):
        shared.wait_for_lane(before)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Tell the other processes that a lane is over, after all of its fixtures."""
    lane = lane_of(item.nodeid)
    try:
        yield
    finally:
        if lane in AFTER.values() and (nextitem is None or lane_of(nextitem.nodeid) != lane):
            shared.end_lane(lane)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """End the cluster; a skip that nobody expected fails a run that is to be complete."""
    if is_worker(session.config):
        return
    shared.end()
    reporter = session.config.pluginmanager.getplugin("terminalreporter")
    if os.environ.get("RIGEL_TEST_STRICT") == "1" and find_unexpected(reporter.stats):
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the time that each lane took, and the skips that nobody expected."""
    spent: dict[str, float] = {}
    unmarked = set()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                lane = lane_of(report.nodeid)
                lane = "tests/unit" if lane.startswith("tests/unit/") else lane
                spent[lane] = spent.get(lane, 0) + report.duration
                if any(name == "unmarked" for name, _ in report.user_properties):
                    unmarked.add(report.nodeid)
    if unmarked:
        terminalreporter.section("tests that start programs and are not marked `programs`")
        terminalreporter.write_line("\n".join(sorted(unmarked)))
    if sum(spent.values()) > MINUTE:
        terminalreporter.section("minutes by lane")
        for lane, seconds in sorted(spent.items(), key=lambda item: -item[1]):
            terminalreporter.write_line(f"{seconds / MINUTE:6.1f}  {lane}")
    if os.environ.get("RIGEL_TEST_STRICT") == "1":
        for line in find_unexpected(terminalreporter.stats):
            terminalreporter.write_line(f"SKIPPED, and not in tests/skips.py: {line}", red=True)


MINUTE = 60.0


@pytest.fixture
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether golden files are to be written (also by UPDATE_GOLDEN=1)."""
    return bool(request.config.getoption("--update-golden"))

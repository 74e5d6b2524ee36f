"""The skips of a complete run, and why they are right; RIGEL_TEST_STRICT=1 fails any other."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import attrs


@attrs.frozen
class Skip:
    """A skip that is expected.

    Attributes:
        tests: the beginning of the tests' ids.
        reason: a regular expression for the reason that pytest reports.
        why: why `./run test` does not provide what is missing.
    """

    tests: str
    reason: str
    why: str


EXPECTED = (
    Skip(
        "tests/unit/rigelfile/test_schema.py",
        "a schema cannot see who uses a job",
        "no schema can say it; another test shows that a check does",
    ),
    Skip(
        "tests/cluster/network/",
        "of k3s only",
        "the tests of a cluster that may be broken run on plain nodes and on k3s'",
    ),
    Skip(
        "tests/",
        "names no (interpreter of an )?environment with Rigel 0.3",
        "Rigel 0.3 is in no package registry: RIGEL03_PYTHON names an environment that has it",
    ),
    Skip(
        "tests/unit/importing/",
        "names no interpreter of an environment with launch_ros",
        "launch_ros is in no package registry: RIGEL_LAUNCH_PYTHON names one that has it",
    ),
    Skip(
        "tests/unit/inpod/",
        r"no Python (2\.7|3\.6) on this machine",
        "Debian 12 and newer have neither; pyenv's are taken where they are",
    ),
    Skip(
        "tests/unit/images/test_engine.py",
        "docker's command line is not here",
        "installing it would start Docker's engine beside whatever the machine runs",
    ),
    Skip(
        "tests/",
        "Chromium is not installed",
        "Ubuntu has it as a snap only; Debian's package is installed",
    ),
    Skip(
        "tests/cluster/ros2/modes/",
        "no cargo 1.85 or newer",
        "Ubuntu 22.04 and 24.04 have an older one",
    ),
    Skip(
        "tests/unit/multus/test_machine.py",
        "this machine has CNI programs of its own",
        "they are where the test must find none",
    ),
    Skip(
        "tests/unit/lab/test_steps.py",
        "no Go toolchain that is new enough",
        "a cluster fetches one only where programs are compiled",
    ),
    Skip(
        "tests/unit/lab/cluster/test_cgroups.py",
        "needs root and a writable cgroup v2 hierarchy",
        "machines have cgroup v1 or v2",
    ),
    Skip(
        "tests/unit/observability/boards/test_dashboards.py",
        "Grafana's builders want Python 3.11",
        "tests/bounds runs the oldest Python that is supported, 3.10",
    ),
)


def find_unexpected(stats: Mapping[str, Sequence[Any]]) -> list[str]:
    """Return the skips that are not listed above, out of the terminal reporter's reports."""
    return [
        f"{report.nodeid}: {reason}"
        for report in stats.get("skipped", ())
        if not is_expected(report.nodeid, reason := reason_of(report))
    ]


def reason_of(report: Any) -> str:
    """Return why a test was skipped."""
    place = report.longrepr
    return str(place[2] if isinstance(place, tuple) else place).removeprefix("Skipped: ")


def is_expected(nodeid: str, reason: str) -> bool:
    """Return whether a skip is listed."""
    return any(
        nodeid.startswith(skip.tests) and re.search(skip.reason, reason) for skip in EXPECTED
    )

"""The runs of `./run test`: which tests run when, which are repeated, what is printed at the end.

Unit tests run while programs and images are built that tests on the cluster need; those run when
all is built, since a cluster that shares the machine with a compiler proves little. A test on the
cluster that fails is repeated once, alone, after all others: if it passes then, it is unsteady,
which the last lines say.

usage: python -m tests.tiers [--lint SECONDS] [--all | --slow]
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import attrs

RESULTS = Path(".test-results")
#: A file system in memory, and the bytes that it must have free for the files of unit tests.
MEMORY, ENOUGH = Path("/dev/shm"), 4 * 2**30
#: pytest's exit code of a run in which some tests failed.
FAILED = 1


@attrs.frozen
class Phase:
    """One run of pytest.

    Attributes:
        name: of its files below RESULTS.
        title: what is printed when it begins.
        marks: which tests, for `-m`.
        processes: how many share the tests; 0: this one alone.
        words: further arguments.
        repeats: whether tests that fail are repeated alone, after all phases.
        in_memory: whether their temporary files are, where there is room: to write and delete
            thousands of small files takes a third of the time on some disks.
    """

    name: str
    title: str
    marks: str
    processes: int
    words: tuple[str, ...] = ()
    repeats: bool = True
    in_memory: bool = False

    @property
    def report(self) -> Path:
        """The JUnit file."""
        return RESULTS / "parts" / f"{self.name}.xml"

    @property
    def cache(self) -> Path:
        """The directory in which pytest leaves the ids of failed tests."""
        return RESULTS / "cache" / self.name

    def run(self, *words: str) -> int:
        """Run the tests, and return pytest's exit code."""
        print(f"\n==> {self.title}", flush=True)
        command = [sys.executable, "-m", "pytest", "-m", self.marks, "-n", str(self.processes)]
        command += ["-o", f"cache_dir={self.cache}", f"--junitxml={self.report}"]
        command += ["--durations=25", "--durations-min=5"]
        with temporary_files(in_memory=self.in_memory) as environ:
            done = subprocess.run([*command, *self.words, *words], check=False, env=environ)
        return done.returncode

    def failed(self) -> list[str]:
        """Return the ids of the tests that failed, in the order in which they ran."""
        file = self.cache / "v" / "cache" / "lastfailed"
        return list(json.loads(file.read_text())) if file.exists() else []


UNIT = Phase(
    "unit",
    "Unit tests",
    "not cluster and not slow and not timing",
    3,
    repeats=False,
    in_memory=True,
)
PROOF = Phase("proof", "The proof: each promise once, on a real cluster", "proof", 3)
CLUSTER = Phase("cluster", "Tests on a real cluster", "cluster and not slow and not timing", 3)
SLOW = Phase("slow", "What is slow by nature", "slow and not timing", 2, ("--all",))
TIMING = Phase("timing", "What measures time", "timing", 0, ("--all",))
AGAIN = Phase("again", "Failed tests once more, alone", "cluster or slow or timing", 0, ("--all",))

TIERS: dict[str, tuple[Phase, ...]] = {
    "": (UNIT, PROOF),
    "--all": (UNIT, CLUSTER, SLOW, TIMING),
    "--slow": (SLOW, TIMING),
}


@contextmanager
def temporary_files(*, in_memory: bool) -> Iterator[dict[str, str]]:
    """Yield an environment, and delete the temporary files that were in memory."""
    if not in_memory or not MEMORY.is_mount() or shutil.disk_usage(MEMORY).free < ENOUGH:
        yield dict(os.environ)
        return
    directory = make_directory()
    try:
        yield {**os.environ, "TMPDIR": directory}
    finally:
        shutil.rmtree(directory, ignore_errors=True)


def make_directory() -> str:
    """Make a directory in memory."""
    return tempfile.mkdtemp(dir=MEMORY, prefix="rigel-k8s-")


@attrs.define
class Run:
    """A run: how long each part of it took, and what failed."""

    minutes: dict[str, float] = attrs.Factory(dict)
    failures: list[str] = attrs.Factory(list)
    unsteady: list[str] = attrs.Factory(list)

    def note(self, part: str, started: float, code: int = 0, failed: Sequence[str] = ()) -> None:
        """Keep how long a part took, and what has failed: tests, or all of it by its exit code."""
        self.minutes[part] = round((time.monotonic() - started) / 60, 1)
        if code:
            self.failures += failed or [f"{part} ended with exit code {code}"]


def main(words: Sequence[str]) -> int:
    """Run a tier and return the exit code of `./run test`."""
    tier = next((word for word in words if word in TIERS), "")
    (RESULTS / "parts").mkdir(parents=True, exist_ok=True)
    for old in (*RESULTS.glob("*.xml"), *RESULTS.glob("parts/*.xml"), *cached_failures()):
        old.unlink()
    run = Run()
    if "--lint" in words:
        run.minutes["lint"] = round(int(words[words.index("--lint") + 1]) / 60, 1)
    builder = start_builds(tier)
    try:
        repeated = run_phases(TIERS[tier], builder, run)
        if repeated:
            repeat(repeated, run)
        if tier in ("--all", "--slow"):
            started = time.monotonic()
            print("\n==> The lowest and the newest requirements", flush=True)
            code = subprocess.run(["tests/bounds"], check=False).returncode
            run.note("bounds", started, code)
    finally:
        if builder and builder.poll() is None:
            os.killpg(builder.pid, 15)
    return conclude(run)


def cached_failures() -> Iterable[Path]:
    """Return the files of earlier runs that list failed tests."""
    return RESULTS.glob("cache/*/v/cache/lastfailed")


def start_builds(tier: str) -> subprocess.Popen[bytes] | None:
    """Start what builds the programs and images of a tier, where its tests use a local cluster."""
    if os.geteuid() != 0 or os.environ.get("RIGEL_TEST_CONTEXT"):
        return None
    os.environ["RIGEL_TEST_STRICT"] = "1"
    log = RESULTS / "builds.log"
    print(f"\n==> Building what the tests on a cluster need (see {log})", flush=True)
    command = ["nice", "-n", "10", sys.executable, "-m", "tests.support.builds", tier or "--proof"]
    return subprocess.Popen(
        command, stdout=log.open("w"), stderr=subprocess.STDOUT, start_new_session=True
    )


def run_phases(
    phases: Sequence[Phase], builder: subprocess.Popen[bytes] | None, run: Run
) -> list[str]:
    """Run phases one after the other; return the tests that are to be repeated."""
    repeated: list[str] = []
    for phase in phases:
        if phase is not UNIT and builder and builder.poll() is None:
            started = time.monotonic()
            print("\n==> Waiting for what is being built", flush=True)
            builder.wait()
            run.note("waiting for builds", started)
        started = time.monotonic()
        code, failed = phase.run(), phase.failed()
        if code == FAILED and failed and phase.repeats:
            repeated += failed
            run.note(phase.name, started)
        else:
            run.note(phase.name, started, code, failed)
    return repeated


def repeat(tests: Sequence[str], run: Run) -> None:
    """Repeat failed tests alone; what passes now is unsteady, the rest has failed."""
    started = time.monotonic()
    again = RESULTS / "again.json"
    again.write_text(json.dumps(list(tests)))
    files = sorted({test.partition("::")[0] for test in tests})
    code = AGAIN.run(f"--again={again}", *files)
    failed = set(AGAIN.failed())
    passed = passed_tests(AGAIN.report) if code in (0, FAILED) else set()
    for test in tests:
        (run.unsteady if test in passed and test not in failed else run.failures).append(test)
    run.note("again", started)


def passed_tests(report: Path) -> set[str]:
    """Return the ids of the tests that passed, from a JUnit file."""
    cases = ET.parse(report).iter("testcase")
    return {id_of(case) for case in cases if not any(p.tag in PROBLEMS for p in case)}


#: What a test case of a JUnit file has that did not pass.
PROBLEMS = {"failure": "flakyFailure", "error": "flakyError", "skipped": "skipped"}


def id_of(case: ET.Element) -> str:
    """Return a test's id, which pytest writes as a module, classes and a name."""
    words = list(filter(None, case.get("classname", "").split(".")))
    for count in range(len(words), 0, -1):
        if (file := Path(*words[:count]).with_suffix(".py")).exists():
            return "::".join([str(file), *words[count:], case.get("name", "")])
    return "::".join([*words, case.get("name", "")])


def merge(unsteady: Sequence[str]) -> dict[str, int]:
    """Write one JUnit file of all phases, and return how many tests had which end.

    An unsteady test passes there, with its failure as `flakyFailure`, as Surefire has it.
    """
    whole, counts = ET.Element("testsuites"), {"passed": 0, "failed": 0, "skipped": 0}
    for part in sorted(RESULTS.glob("parts/*.xml")):
        if part == AGAIN.report:
            continue
        for suite in ET.parse(part).getroot().iter("testsuite"):
            suite.set("name", part.stem)
            for case in suite.iter("testcase"):
                ends = [child for child in case if child.tag in PROBLEMS]
                if ends and id_of(case) in unsteady:
                    for end in ends:
                        end.tag = PROBLEMS[end.tag]
                    ends = []
                tags = {end.tag for end in ends}
                end = "failed" if tags & {"failure", "error"} else "skipped" if tags else "passed"
                counts[end] += 1
            for name, tag in (("failures", "failure"), ("errors", "error")):
                suite.set(name, str(len(suite.findall(f"testcase/{tag}"))))
            whole.append(suite)
    ET.ElementTree(whole).write(RESULTS / "junit.xml", encoding="utf-8", xml_declaration=True)
    return counts


def conclude(run: Run) -> int:
    """Print and keep what the run was; return its exit code."""
    counts = merge(run.unsteady)
    git = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    minutes = round(sum(run.minutes.values()), 1)
    whole = {"commit": commit, "minutes": run.minutes, "whole": minutes, **attrs.asdict(run)}
    (RESULTS / "run.json").write_text(json.dumps({**whole, "tests": counts}, indent=2))
    print(f"\n==> Commit {commit or 'unknown'}: {minutes} minutes")
    for part, took in run.minutes.items():
        print(f"{took:6.1f}  {part}")
    if run.unsteady:
        print(f"unsteady: {len(run.unsteady)} ({', '.join(run.unsteady)})")
    for failure in run.failures:
        print(f"failed: {failure}")
    print(f"{counts['passed']} passed, {counts['failed']} failed, {counts['skipped']} skipped")
    return 1 if run.failures or counts["failed"] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

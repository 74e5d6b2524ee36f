"""The tests of one release: those of guests, and its nodes of `kind: test`."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

import attrs

from rigel_k8s.app.deploying.guests import State, load_guests
from rigel_k8s.app.deploying.results import copy_out
from rigel_k8s.app.testing import READER, RESULTS, TEST_ANNOTATION, make_test_pod
from rigel_k8s.commands.targets import Release
from rigel_k8s.commands.testing.results import LOGS, Result, name_folder, save_log
from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import NODE_ANNOTATION
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.part import Run
from rigel_k8s.release.rollout.causes import containers, explain_exit, explain_pod
from rigel_k8s.release.rollout.patience import Ledger, Patience
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter

#: Seconds between two looks at a test that runs.
LOOK = 0.5


@attrs.frozen
class ReleaseTests:
    """The tests of one release.

    Attributes:
        folder: where their logs and files go.
        results: of those that have ended, by name; of a topic the worse one.
    """

    found: Release
    report: Reporter
    within: float
    folder: Path
    cancel: threading.Event
    results: dict[str, Result] = attrs.field(factory=dict)

    def run(self) -> None:
        """Note the tests of guests, before and after its own, and those."""
        tests = self.list_tests()
        self.results.update((one.name, one) for one in self.ask_guests(self.within))
        for job in tests:
            ended = self.run_test(job)
            self.results[ended.name] = ended
        for one in self.ask_guests(0.0) if tests else ():
            if one.state == "failed":
                self.results[one.name] = one

    def ask_guests(self, wait: float) -> Iterator[Result]:
        """Yield how the tests of guests ended; they may take `wait` seconds to pass."""
        options = DeployOptions(report=self.report, cancel=self.cancel)
        run = Run.of_objects(self.found.cluster, self.found.id, options)
        for guest in load_guests():
            for name, state, why in guest.test(run, wait):
                yield Result(self.found.id.name, name, state, message=why)

    def list_tests(self) -> list[Manifest]:
        """Return the Jobs of its tests, by name."""
        found, (namespace, name) = self.found, attrs.astuple(self.found.id)
        labels = {RELEASE_LABEL: name}
        return [
            one
            for one in found.cluster.list("batch/v1", "Job", namespace, labels=labels)
            if TEST_ANNOTATION in (one["metadata"].get("annotations") or {})
        ]

    def run_test(self, job: Manifest) -> Result:
        """Run a test to its end."""
        cluster, pod = self.found.cluster, make_test_pod(job)
        ref, container = ref_of(pod), pod["spec"]["containers"][0]["name"]
        name = job["metadata"]["annotations"][NODE_ANNOTATION]
        started = time.monotonic()
        self.report.progress(name, "runs")
        cluster.create(pod)
        try:
            message = self.wait(ref, container)
            seconds = time.monotonic() - started
            log = save_log(self.found, ref.name, container, self.folder / LOGS)
            self.fetch_files(ref, self.folder / name_folder(name))
        finally:
            cluster.delete(ref, grace_seconds=0)
        self.report.progress(name, "" if message else "passed", done=True)
        if message:
            self.report.line(f"{name} has failed: {message}")
        state: State = "failed" if message else "passed"
        return Result(self.found.id.name, name, state, seconds, message, log)

    def wait(self, ref: ObjectRef, container: str) -> str:
        """Return why a test has not passed, "" if it has."""
        ledger, deadline = Ledger(Patience()), time.monotonic() + self.within
        while not self.cancel.wait(LOOK):
            live, now = self.found.cluster.get(ref), time.monotonic()
            if live is None:
                return "its pod was deleted"
            own = find_container(live, container)
            if in_state(own, "terminated"):
                cause = next(explain_exit(ref.name, own), None)
                return cause.message if cause else ""
            causes = []
            if not in_state(own, "running"):
                causes = list(explain_pod(live, self.found.cluster.events(live)))
            ledger.note(now, [(ref, cause) for cause in causes])
            if hopeless := next(ledger.find_hopeless(now), None):
                return hopeless.cause.message
            if now > deadline:
                why = f": {causes[0].message}" if causes else ""
                return f"it has not ended within {self.within:g} s{why}"
        raise Interrupted(f"interrupted while the test {ref.name} ran")

    def fetch_files(self, ref: ObjectRef, folder: Path) -> None:
        """Copy what a test has written to RESULTS into a folder, if it has begun."""
        live = self.found.cluster.get(ref)
        if live is None or not in_state(find_container(live, READER), "running"):
            return
        place = (ref.namespace, ref.name, READER)
        try:
            copy_out(self.found.cluster, place, (PurePosixPath(RESULTS), "."), folder)
        except RigelK8sError as error:
            self.report.warn(f"{ref.name}: its files were not fetched: {error.message}")
        with suppress(OSError):
            folder.rmdir()  # it has written nothing


def find_container(pod: Manifest, name: str) -> Mapping[str, Any]:
    """Return the status of a pod's container, empty before it has one."""
    found = containers(pod.get("status") or {})
    return next((one for one in found if one["name"] == name), {})


def in_state(container: Mapping[str, Any], state: str) -> bool:
    """Return whether a container is waiting, running or terminated."""
    return state in (container.get("state") or {})

"""The bags of a release's `record`, in the pod of its recorder: list, fetch, delete."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import BinaryIO, cast

import attrs

from rigel_k8s.app.recording import FOLDER, NODE, VOLUME
from rigel_k8s.commands.pods import Pod, choose_running, find_matching, release_pods, run_tied
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import ClusterError, RigelK8sError, UserError
from rigel_k8s.objects.naming import selector
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.report import Reporter
from rigel_k8s.rigelfile import name_nearest
from rigel_k8s.settings import Settings

#: States of a bag that is not complete.
UNFINISHED = ("recording", "unclosed")
MIB = 2**20
#: Seconds between two reports of a copy.
PAUSE = 1.0
#: Seconds that the recorder's pod has to answer.
ANSWER = 60.0


@attrs.frozen
class Bag:
    """A bag; src/rigel_inpod/record.py describes it.

    Attributes:
        started: seconds since 1970; seconds: its length; None: not known.
        files: path below the folder of bags -> bytes.
    """

    name: str
    state: str
    started: float | None
    seconds: float | None
    size: int
    files: dict[str, int] = attrs.field(converter=dict)

    @property
    def target(self) -> str:
        """What it is called here: a folder in ROS 2, a file in ROS 1, as the recorder calls it."""
        first = PurePosixPath(next(iter(self.files), self.name))
        whole = first.name if ".bag" in first.name else self.name
        return PurePosixPath(whole).name


@attrs.frozen
class Recorder:
    """A release's recorder, connected."""

    found: Release
    pod: Pod

    def call(self, *words: str) -> str:
        """Return what record.py prints.

        Raises:
            UserError: it refuses.
        """
        pod = self.pod
        command = ["/bin/sh", f"{SCRIPTS_PATH}/record.sh", FOLDER, *words]
        done = self.found.cluster.run(
            pod.namespace, pod.name, command, container=pod.container, timeout=ANSWER
        )
        if done.code:
            lines = (done.stderr or done.stdout).decode("utf-8", "replace").splitlines()
            *more, last = lines or [f"the recorder's script ended with exit code {done.code}"]
            raise UserError(last, details=more)
        return done.stdout.decode()

    def list(self) -> list[Bag]:
        """Return its bags, the oldest first."""
        return [Bag(**one) for one in json.loads(self.call("list"))]


def open_recorder(settings: Settings, job: str | None) -> Recorder:
    """Return the recorder of a release.

    Raises:
        UserError: it does not run, or the release records nothing.
    """
    found = release(settings, job)
    if pods := find_matching(release_pods(found), NODE):
        return Recorder(found, choose_running(pods))
    name, namespace = found.id.name, found.id.namespace
    labels = ",".join(f"{key}={value}" for key, value in selector(VOLUME).items())
    if found.cluster.list("v1", "PersistentVolumeClaim", namespace, labels=labels):
        raise UserError(
            f"the recorder of {name} does not run in {namespace}, so its bags cannot be read; they"
            f" are on the volume {VOLUME}-pvc",
            hint="deploy the release with `rigel run`; it mounts the same volume again",
        )
    raise UserError(
        f"{name} records no bags in the namespace {namespace}",
        hint="add `record: true` to its job, and deploy it; or choose another namespace with -n",
    )


def list_bags(settings: Settings, job: str | None) -> list[Bag]:
    """Return the bags of a release, the oldest first."""
    recorder = open_recorder(settings, job)
    with recorder.found.cluster:
        return recorder.list()


def choose(bags: Sequence[Bag], names: Sequence[str]) -> list[Bag]:
    """Return the bags with some names.

    Raises:
        UserError: there is no such bag.
    """
    there = {bag.name: bag for bag in bags}
    for name in names:
        if name not in there:
            meant = name_nearest(name, there)
            raise UserError(f'no bag "{name}"{meant}', hint="`rigel bags list` lists all")
    return [there[name] for name in dict.fromkeys(names)]


def fetch(
    settings: Settings,
    job: str | None,
    names: Sequence[str],
    last: int | None,
    to: Path,
    report: Reporter,
) -> list[Path]:
    """Copy bags into a folder of this computer and return where they are.

    A bag that is there already is not copied again; one that arrives has another name until it is
    complete.

    Args:
        names: all closed ones if empty.
        last: only so many of the newest ones.

    Raises:
        UserError: there is no such bag.
        RigelK8sError: a copy is incomplete, or cannot be written.
    """
    recorder = open_recorder(settings, job)
    with recorder.found.cluster:
        bags = recorder.list()
        chosen = choose(bags, names) or [bag for bag in bags if bag.state not in UNFINISHED]
        chosen = chosen[-last:] if last else chosen
        try:
            to.mkdir(parents=True, exist_ok=True)
            return [copy(recorder, bag, to, report) for bag in chosen]
        except OSError as error:
            raise RigelK8sError(f"cannot write to {to}: {error.strerror}") from error


def copy(recorder: Recorder, bag: Bag, to: Path, report: Reporter) -> Path:
    target, partial = to / bag.target, to / f".{bag.target}.partial"
    if target.exists():
        report.line(f"{target} exists already")
        return target
    if bag.state in UNFINISHED:
        report.warn(f"{bag.name} is being written: the copy has no index and must be repaired")
    remove(partial)
    try:
        if single := target.name.endswith((".bag", ".active")):
            partial.touch()
        else:
            partial.mkdir()
        progress = Progress(bag, report)
        for path, size in bag.files.items():
            place = partial if single else partial / PurePosixPath(path).name
            received = receive(recorder, path, place, progress)
            if received != size and bag.state not in UNFINISHED:
                raise ClusterError(
                    f"the copy of {bag.name} is incomplete: {received} of {size} bytes",
                    hint="fetch it again",
                )
        partial.rename(target)
    finally:
        remove(partial)
    report.progress(bag.name, f"copied to {target}", done=True)
    return target


@attrs.define
class Progress:
    """Reports how much of a bag has arrived."""

    bag: Bag
    report: Reporter
    arrived: int = 0
    last: float = attrs.field(factory=time.monotonic)

    def add(self, count: int) -> None:
        """Count bytes, and report them if the last report is old."""
        self.arrived += count
        if time.monotonic() - self.last >= PAUSE:
            self.last = time.monotonic()
            done, whole = self.arrived / MIB, self.bag.size / MIB
            self.report.progress(self.bag.name, f"{done:,.0f} of {whole:,.0f} MiB")


@attrs.define
class Sink:
    """A file that reports what is written to it."""

    file: BinaryIO
    progress: Progress
    count: int = 0

    def write(self, data: bytes) -> int:
        self.file.write(data)
        self.count += len(data)
        self.progress.add(len(data))
        return len(data)

    def flush(self) -> None:
        """Leave it to the file when it writes."""


def receive(recorder: Recorder, path: str, place: Path, progress: Progress) -> int:
    """Copy one file, and return how many bytes have arrived.

    Raises:
        ClusterError: it cannot be read.
    """
    errors = BytesIO()
    with place.open("wb") as file:
        sink = Sink(file, progress)
        command = ["cat", f"{FOLDER}/{path}"]
        found, output = recorder.found, cast("BinaryIO", sink)
        code = run_tied(found.cluster, recorder.pod, command, output, errors)
        file.flush()
        os.fsync(file.fileno())
    if code:
        said = errors.getvalue().decode("utf-8", "replace").splitlines()
        raise ClusterError(f"{path} cannot be read in the recorder's pod", details=said)
    return sink.count


def remove(path: Path) -> None:
    """Delete a file or a folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def delete(recorder: Recorder, bags: Sequence[Bag]) -> None:
    """Delete bags.

    Raises:
        UserError: one of them is being written; nothing is deleted.
    """
    if bags:
        recorder.call("delete", *(bag.name for bag in bags))

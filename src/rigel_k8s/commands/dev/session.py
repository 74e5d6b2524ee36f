"""A session of `rigel dev`: each change of a file is copied, and the output followed."""

from __future__ import annotations

import io
import shlex
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import attrs

from rigel_k8s.app.development import FOLDER, REQUESTS, wrap_deployment
from rigel_k8s.commands.dev.files import REMOVED, File, Folder, compare, list_files, pack
from rigel_k8s.commands.interruption import writing
from rigel_k8s.commands.pods import Pod, check_script, pod_of, pods_of, run_tied, wrap_command
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.objects.facts import is_ending
from rigel_k8s.objects.marks import NAME_LABEL, find_development
from rigel_k8s.objects.podnodes import split_all
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.objects.text import plural
from rigel_k8s.release import development
from rigel_k8s.release.locking import name_user, timestamp
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings

LOOK = 0.3  # seconds between two looks at a pod that starts
STEP = 50  # milliseconds without a further change after which changes are copied
ENDED = 1.0  # seconds after which the output of a container that has ended is over
COPY_LIMIT = 600.0  # seconds
#: Takes the archive's size: a websocket of an older Kubernetes cannot end the input.
COPY = (
    f'until [ -p {REQUESTS} ]; do sleep 0.1 || sleep 1; done; head -c "$1" | tar -xmof - -C /'
    f" && xargs -0 rm -f -- <{FOLDER}/{REMOVED}"
)
RESTART = f" && echo restart 1<>{REQUESTS}"


@attrs.define
class Life:
    """A container from its start to its end: then all files are copied again.

    Attributes:
        key: differs for each container.
        sent: the files that it has, by their path there; None before the first copy.
        over: set when its output has ended, or the first copy failed.
        failure: why the first copy failed.
    """

    pod: Pod
    key: str
    sent: Mapping[str, File] | None = None
    over: threading.Event = attrs.field(factory=threading.Event)
    failure: Exception | None = None


@attrs.frozen
class Session:
    """What is developed, and how.

    Attributes:
        pod: the node's pod before, of the Deployment `ref`.
        note: by which the session's own pod is found.
        show: takes the lines of the node's output.
    """

    found: Release
    pod: Pod
    ref: ObjectRef
    note: str
    folders: Sequence[Folder]
    command: Sequence[str]
    options: DeployOptions
    show: Callable[[str], None]

    def run(self) -> None:
        """Copy changes until the user interrupts it.

        Raises:
            ClusterError: the pod does not start, the first copy fails, or another process has
                deployed the node.
        """
        life: Life | None = None
        while (life := self.find_life(life)) is not None:
            threading.Thread(target=self.follow, args=(life,), daemon=True).start()
            self.copy_changes(life)
            if life.failure:
                raise ClusterError(
                    f"the program has not started: {life.failure}",
                    hint=getattr(life.failure, "hint", None),
                ) from life.failure

    def find_life(self, last: Life | None) -> Life | None:
        """Return the running container, None if the user interrupts the wait for it."""
        deadline = time.monotonic() + self.options.limit
        labels = {NAME_LABEL: self.ref.name}
        while not self.options.cancel.is_set():
            for item in split_all(list_pods(self.found.cluster, self.found.id, labels)):
                key = find_running(item, self.pod.container)
                if key and find_development(item) == self.note and not is_ending(item):
                    return Life(pod_of(item), key, last.sent if last and last.key == key else None)
            if find_development(self.found.cluster.get(self.ref)) != self.note:
                raise ClusterError(f"another process has deployed {self.ref.name}: stopped")
            if time.monotonic() > deadline:
                raise ClusterError(
                    f"no pod of {self.ref.name} runs after {self.options.limit:g} s",
                    hint="--timeout 10m waits longer",
                )
            self.options.cancel.wait(LOOK)
        return None

    def follow(self, life: Life) -> None:
        """Show a container's output, and note its end."""
        place = life.pod.namespace, life.pod.name, life.pod.container
        tail = 0 if life.sent else None  # the connection had ended, not the container
        try:
            for line in self.found.cluster.logs(
                *place, follow=True, tail=tail, cancel=self.options.cancel
            ):
                self.show(line)
        except RigelK8sError as error:
            self.options.report.warn(error.message)
        finally:
            self.options.cancel.wait(LOOK)
            life.over.set()

    def copy_changes(self, life: Life) -> None:
        """Copy all that differs, and again after each change, until the container has ended."""
        from watchfiles import watch

        watched, first = [folder.local for folder in self.folders], True
        for changes in watch(
            *watched, watch_filter=None, step=STEP, stop_event=life.over, rust_timeout=200,
            yield_on_timeout=True, raise_interrupt=False,
        ):  # fmt: skip
            files = list_files(self.folders) if changes or first else life.sent or {}
            first = False
            if any(compare(life.sent or {}, files)):
                worker = threading.Thread(target=self.update, args=(life, files), daemon=True)
                worker.start()
                while worker.is_alive() and not life.over.is_set():
                    worker.join(LOOK)

    def update(self, life: Life, files: Mapping[str, File]) -> None:
        """Copy what differs, and start the program again.

        What fails is a warning; the first copy of a container ends the session if it fails.
        """
        changed, removed = compare(life.sent or {}, files)
        report = self.options.report
        first = life.sent is None
        try:
            self.copy(life.pod, pack(files, changed, removed, FOLDER))
            life.sent = files
            report.line(f"{plural(len(changed), 'file')} copied, {len(removed)} removed")
            if self.command:
                self.build(life.pod)
        except (ClusterError, OSError) as error:
            if life.over.wait(ENDED if first else 0):
                return
            if life.sent is None:
                life.failure = error
                life.over.set()
            else:
                goes = "starts without that" if first else "goes on as it was"
                report.warn(f"{error}; the program {goes}, and the next change tries again")

    def copy(self, pod: Pod, archive: bytes) -> None:
        """Unpack an archive in the container; without a command, start the program again."""
        words = ["/bin/sh", "-c", COPY + ("" if self.command else RESTART), "sh", str(len(archive))]
        done = self.found.cluster.run(
            pod.namespace,
            pod.name,
            words,
            container=pod.container,
            stdin=archive,
            timeout=COPY_LIMIT,
        )
        if done.code:
            why, _, _ = done.stderr.decode("utf-8", "replace").strip().partition("\n")
            raise ClusterError(
                f"cannot copy: {why}",
                hint="PATH of --sync must be a folder that the container's user can write to",
            )

    def build(self, pod: Pod) -> None:
        """Run the command in the container, and start the program again if it succeeds."""
        output = io.BytesIO()
        words = wrap_command(pod, ["/bin/sh", "-c", f'"$@"{RESTART}', "sh", *self.command])
        self.options.report.line(shlex.join(self.command))
        if code := run_tied(self.found.cluster, pod, words, output, output):
            for text in output.getvalue().decode("utf-8", "replace").splitlines():
                self.options.report.line(text)
            raise ClusterError(f"{self.command[0]} has ended with exit code {code}")


def find_running(item: Manifest, container: str) -> str | None:
    """Return what identifies the run of a pod's container, None if it does not run."""
    for one in item["status"].get("containerStatuses") or []:
        if one["name"] == container and "running" in one["state"]:
            return str(one["containerID"])
    return None


def develop(
    settings: Settings,
    node: str,
    folders: Sequence[Folder],
    command: Sequence[str],
    report: Reporter,
    show: Callable[[str], None],
    job: str | None = None,
) -> None:
    """Develop a node until Ctrl-C or SIGTERM; then its Deployment is as before.

    Args:
        command: run in the container after each copy; empty for none.
        show: takes the lines of the node's output.

    Raises:
        UserError: there is no such node, it cannot be developed, or another process does.
        ClusterError: see Session.run; the Deployment is as before, unless the cluster refused that.
        RolloutFailed: the release's version does not become ready again.
    """
    found = release(settings, job, [node])
    with writing(found.cluster, settings, report) as options:
        pod = pods_of(found, node)[0]
        ref = pod.find_deployment("developed")
        note = f"{node} is in development by {name_user()} since {timestamp()}"
        check_script(found, "dev.sh", "developed")
        synced = [str(folder.remote) for folder in folders]
        change = partial(
            wrap_deployment,
            name=pod.container,
            note=note,
            synced=synced,
            copied=list_files(folders),
        )
        with development.changed(found.cluster, found.id, ref, note, change, options):
            report.line(f"{node} is in development; Ctrl-C ends that")
            Session(found, pod, ref, note, folders, command, options, show).run()

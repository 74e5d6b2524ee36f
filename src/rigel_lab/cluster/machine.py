"""One machine of a local cluster: a set of namespaces whose first process ends all others with it.

It starts, recognizes and ends a machine, independent of what runs on it.
"""

from __future__ import annotations

import os
import shlex
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import attrs

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster.commands import run

#: Where a machine's process writes its own line of /proc/PID/stat before it becomes the machine.
RECORD = "process"


@attrs.frozen
class Process:
    """A process that cannot be mistaken for another: its id and when it started (clock ticks)."""

    pid: int
    start: int

    @classmethod
    def parse(cls, stat: str) -> Process | None:
        """Return the process of a line of /proc/PID/stat, None if it has ended."""
        head, _, tail = stat.rpartition(")")
        fields = tail.split()
        return (
            None if not fields or fields[0] in "ZX" else cls(int(head.split()[0]), int(fields[19]))
        )

    @classmethod
    def of(cls, pid: int) -> Process | None:
        """Return the process that has this id now."""
        try:
            return cls.parse(Path(f"/proc/{pid}/stat").read_text())
        except OSError:
            return None

    @property
    def alive(self) -> bool:
        """Whether this very process still runs."""
        return Process.of(self.pid) == self

    def children(self) -> list[Process]:
        """Return the processes that it started itself."""
        with suppress(OSError):
            words = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text().split()
            return [child for pid in words if (child := Process.of(int(pid)))]
        return []

    def kill(self, seconds: float = 20) -> None:
        """End it with SIGKILL and wait until it has ended.

        Raises:
            LocalClusterError: it still exists (uninterruptible sleep).
        """
        deadline = time.monotonic() + seconds
        while self.alive:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            if time.monotonic() > deadline:
                raise LocalClusterError(
                    f"process {self.pid} does not end", hint=f"see /proc/{self.pid}/wchan"
                )
            time.sleep(0.01)


def read_process(directory: Path) -> Process | None:
    """Return the process of the machine that was started last in a directory."""
    with suppress(FileNotFoundError):
        return Process.parse((directory / RECORD).read_text())
    return None


def first_processes(namespace: str) -> Iterator[Process]:
    """Yield each process that is the first of a PID namespace and lives in a network namespace.

    A machine whose record was lost is one too; another user's `nsenter` into it is not.
    """
    with suppress(OSError):
        wanted = Path("/run/netns", namespace).stat().st_ino
        for entry in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if (entry / "ns/net").stat().st_ino == wanted and is_first(entry):
                    yield from filter(None, [Process.of(int(entry.name))])


def is_first(entry: Path) -> bool:
    """Return whether a process is number 1 of a PID namespace below ours."""
    for line in (entry / "status").read_text().splitlines():
        if line.startswith("NSpid:"):
            numbers = line.split()[1:]
            return len(numbers) > 1 and numbers[-1] == "1"
    return False


def end(directory: Path, namespace: str) -> None:
    """End a machine, in whatever state it is; all its processes have ended then."""
    process = read_process(directory)
    started = [process, *process.children()] if process and process.alive else []
    for each in [*started, *first_processes(namespace)]:
        each.kill()
    (directory / RECORD).unlink(missing_ok=True)


@attrs.frozen
class Machine:
    """The definition of a machine.

    Attributes:
        namespace: the named network namespace it lives in.
        directory: its own directory on the host; logs go to `logs` in it.
        binds: directory of the host -> path inside that it is bound over.
        services: name -> command line; each is started again when it ends.
        setup: shell lines before the services.
        environment: all variables that the services get.
        init: the program that becomes process 1 after the start and reaps (catatonit).
    """

    name: str
    namespace: str
    directory: Path
    init: str
    services: Mapping[str, Sequence[str]]
    environment: Mapping[str, str]
    binds: Mapping[Path, str] = attrs.field(factory=dict)
    setup: Sequence[str] = ()

    @property
    def logs(self) -> Path:
        """The directory of the services' logs."""
        return self.directory / "logs"

    def start(self) -> None:
        """Start the machine; its process is recorded before it is a machine.

        Raises:
            LocalClusterError: it ended at once.
        """
        self.logs.mkdir(parents=True, exist_ok=True)
        for source in self.binds:
            source.mkdir(parents=True, exist_ok=True)
        (self.directory / "init.sh").write_text(self.init_script())
        launch = self.directory / "launch.sh"
        launch.write_text(self.launch_script())
        (self.directory / RECORD).unlink(missing_ok=True)
        log = shlex.quote(str(self.logs / "machine.log"))
        # In the background of a shell that ends: a machine has no parent process.
        run(
            [
                "/bin/sh",
                "-c",
                f"setsid /bin/sh {shlex.quote(str(launch))} </dev/null >>{log} 2>&1 &",
            ]
        )
        self.wait()

    def wait(self, seconds: float = 10) -> None:
        """Wait until the machine is recorded."""
        deadline = time.monotonic() + seconds
        while not read_process(self.directory):
            if time.monotonic() > deadline:
                log = self.logs / "machine.log"
                raise LocalClusterError(
                    f"{self.name} did not start",
                    details=log.read_text().splitlines()[-5:] if log.exists() else (),
                    hint=f"its log: {log}",
                )
            time.sleep(0.01)

    def launch_script(self) -> str:
        """Return the script that records itself and then becomes the machine's outer process."""
        variables = [f"{key}={value}" for key, value in self.environment.items()]
        command = ["env", "-i", *variables]
        command += ["nsenter", f"--net=/run/netns/{self.namespace}"]
        # Mounts of the host appear and disappear (slave): nothing that it unmounts is held here.
        command += ["unshare", "--mount", "--uts", "--pid", "--ipc", "--fork", "--kill-child"]
        command += ["--mount-proc", "--propagation", "slave"]
        command += ["/bin/sh", str(self.directory / "init.sh")]
        record = shlex.quote(str(self.directory / RECORD))
        return (
            "read -r stat </proc/$$/stat\n"
            f'printf "%s\\n" "$stat" >{record}.new && mv {record}.new {record} || exit 1\n'
            f"cd / && exec {shlex.join(command)}\n"
        )

    def init_script(self) -> str:
        """Return the script that process 1 runs before it becomes `init`."""
        lines = [
            "set -eu",
            "mount --make-rshared /",
            f"hostname {shlex.quote(self.name)}",
            "mount -t tmpfs -o mode=755,size=256m tmpfs /run",
            "mkdir -p /run/lock",
        ]
        for source, target in self.binds.items():
            lines.append(f"mount --bind {shlex.quote(str(source))} {shlex.quote(target)}")
            lines.append(f"mount --make-rshared {shlex.quote(target)}")
        lines += self.setup
        lines.append(
            "keep() { log=$1; shift; while :; do\n"
            '  "$@" >>"$log" 2>&1 </dev/null || true\n'
            '  echo "--- ended at $(date -u +%FT%TZ); starting again" >>"$log"; sleep 1\n'
            "done; }"
        )
        for name, command in self.services.items():
            lines.append(f"keep {shlex.quote(str(self.logs / name))}.log {shlex.join(command)} &")
        lines.append(f"exec {shlex.quote(self.init)} -P")
        return "\n".join(lines) + "\n"

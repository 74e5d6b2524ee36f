"""One machine of a local cluster: a set of namespaces whose first process takes all others with it.

It knows how a machine is started, recognised and ended, not what runs on it.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import attrs

from rigel_k8s.errors import LocalClusterError

__all__ = ["Machine", "Process", "running_in"]


@attrs.frozen
class Process:
    """A process that cannot be taken for another: its id and when it started (clock ticks)."""

    pid: int
    start: int

    @classmethod
    def of(cls, pid: int) -> Process | None:
        """Return the process that has this id now."""
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return None
        return None if fields[0] == "Z" else cls(pid, int(fields[19]))

    @property
    def alive(self) -> bool:
        """Whether this very process still runs."""
        return Process.of(self.pid) == self

    def kill(self, seconds: float = 10) -> None:
        """End it with SIGKILL and wait until it is gone.

        Raises:
            LocalClusterError: it is there still (uninterruptible sleep).
        """
        deadline = time.monotonic() + seconds
        while self.alive:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            with suppress(ChildProcessError):
                os.waitpid(self.pid, os.WNOHANG)
            if time.monotonic() > deadline:
                raise LocalClusterError(f"process {self.pid} does not end")
            time.sleep(0.02)


def running_in(namespace: str) -> list[Process]:
    """Return every process whose network namespace is this named one."""
    try:
        wanted = Path("/run/netns", namespace).stat().st_ino
    except OSError:
        return []
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                if (entry / "ns/net").stat().st_ino == wanted and (
                    p := Process.of(int(entry.name))
                ):
                    found.append(p)
    return found


@attrs.frozen
class Machine:
    """What a machine is and runs.

    Attributes:
        namespace: the named network namespace it lives in.
        directory: its own directory on the host; logs go to `logs` in it.
        binds: directory of the host -> path inside that it is bound over.
        services: name -> command line; each is started again where it ends.
        setup: shell lines before the services.
        path: directories of programs, before the system's.
        init: the program that becomes process 1 after the start and reaps (catatonit).
    """

    name: str
    namespace: str
    directory: Path
    init: Path
    services: Mapping[str, Sequence[str]]
    binds: Mapping[str, str] = attrs.field(factory=dict)
    setup: Sequence[str] = ()
    path: Sequence[str] = ()

    @property
    def logs(self) -> Path:
        """Where each service's output goes."""
        return self.directory / "logs"

    def script(self) -> str:
        """Return the shell script that process 1 runs before it becomes `init`."""
        lines = [
            "set -eu",
            f"PATH={':'.join([*self.path, '/usr/sbin:/usr/bin:/sbin:/bin'])}; export PATH",
            "mount --make-rshared /",
            f"hostname {self.name}",
            "mount -t tmpfs -o mode=755,size=256m tmpfs /run",
            "mkdir -p /run/lock",
        ]
        for source, target in self.binds.items():
            lines.append(f"mount --bind {shlex.quote(source)} {shlex.quote(target)}")
            lines.append(f"mount --make-rshared {shlex.quote(target)}")
        lines += self.setup
        lines.append(
            "keep() { log=$1; shift; while :; do\n"
            '  "$@" >>"$log" 2>&1 </dev/null || true\n'
            '  echo "--- ended; starting again" >>"$log"; sleep 1\n'
            "done; }"
        )
        for name, command in self.services.items():
            lines.append(f"keep {shlex.quote(str(self.logs / name))}.log {shlex.join(command)} &")
        lines.append(f"exec {shlex.quote(str(self.init))} -P")
        return "\n".join(lines) + "\n"

    def start(self) -> Process:
        """Start the machine and return the process whose end ends all of it."""
        self.logs.mkdir(parents=True, exist_ok=True)
        for source in self.binds:
            Path(source).mkdir(parents=True, exist_ok=True)
        script = self.directory / "init.sh"
        script.write_text(self.script())
        with (self.logs / "machine.log").open("a") as log:
            child = subprocess.Popen(
                ["nsenter", f"--net=/run/netns/{self.namespace}"]
                + ["unshare", "--mount", "--uts", "--pid", "--ipc", "--fork", "--kill-child"]
                + ["--mount-proc", "--propagation", "private", "/bin/sh", str(script)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
                cwd="/",
            )
        if not (process := Process.of(child.pid)):
            raise LocalClusterError(f"{self.name} ended at once", hint=f"see {self.logs}")
        return process

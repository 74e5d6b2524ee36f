"""Runs commands of `rigel` in forks of a warm process: a start costs milliseconds, not a second.

The process that forks has no thread besides its own. With faults the client's waits are shorter,
in proportion: an outage of a second stands for one of twenty.
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO

#: What is shorter in the bench: module, name, seconds.
SCALE = (
    ("kube.connections", "CONNECT_TIMEOUT", 2.0),
    ("kube.connections", "READ_TIMEOUT", 2.5),
    ("kube.transport", "READ_TIMEOUT", 2.5),
    ("kube.transport", "WHOLE_TIMEOUT", 10.0),
    ("kube.transport", "AWAY", 6.0),
    ("kube.transport", "RETRY_BUDGET", 3.0),
    ("kube.transport", "FIRST_PAUSE", 0.05),
    ("kube.transport", "LONGEST_PAUSE", 0.5),
    ("kube.transport", "SILENT", 0.2),
    ("kube.watching", "PAUSE", 0.1),
    ("kube.watching", "SILENCE", 2.0),
)
#: Modules that commands import late; imported once, before the forks.
WARM = (
    *("rigel_k8s.cli.runs", "rigel_k8s.cli.releases", "rigel_k8s.kube.cluster", "rigel_k8s.deploy"),
    *("rigel_k8s.release.removal", "rigel_k8s.jobs.types.orchestration"),
    *("rigel_k8s.app.deploying.prepare", "rigel_graph.hooks", "rigel_graph.watching"),
)
HUNG = 124  # the exit code of a command that did not end


class Caller:
    """A process that runs commands, one after the other."""

    def __init__(self) -> None:
        down, self.requests = os.pipe()
        answers, up = os.pipe()
        self.pid = os.fork()
        if not self.pid:
            os.close(self.requests)
            os.close(answers)
            serve(os.fdopen(down), os.fdopen(up, "w"))
            os._exit(0)
        os.close(down)
        os.close(up)
        self.answers = os.fdopen(answers)

    def call(self, words: Sequence[str], output: Path, seconds: float, *, impatient: bool) -> int:
        """Run `rigel` and return its exit code, HUNG if it did not end in time.

        Args:
            impatient: with the shorter waits.
        """
        request = {"words": words, "output": str(output), "impatient": impatient}
        request["seconds"] = seconds
        os.write(self.requests, json.dumps(request).encode() + b"\n")
        answer: int = json.loads(self.answers.readline())
        return answer

    def close(self) -> None:
        """End the process."""
        os.close(self.requests)
        os.waitpid(self.pid, 0)


def serve(requests: TextIO, answers: TextIO) -> None:
    """Run the requested commands until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warm_up()
    for line in requests:
        request = json.loads(line)
        child = os.fork()
        if not child:
            run(request["words"], request["output"], impatient=request["impatient"])
        answers.write(f"{wait(child, request['seconds'])}\n")
        answers.flush()


def warm_up() -> None:
    """Import what commands need."""
    for name in WARM:
        import_module(name)


def shorten_waits() -> None:
    """Shorten the waits of the client."""
    for module, name, seconds in SCALE:
        found = import_module(f"rigel_k8s.{module}")
        if not hasattr(found, name):
            raise AttributeError(f"{module} has no {name}")
        setattr(found, name, seconds)


def run(words: Sequence[str], output: str, *, impatient: bool) -> None:
    """Run as `rigel`; does not return."""
    code: Any = 70
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        target = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(target, 1)
        os.dup2(target, 2)
        faulthandler.register(signal.SIGUSR1, file=2)  # prints where it hangs
        from rigel_k8s.cli.main import main

        if impatient:
            shorten_waits()
        main(words, name="rigel")
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def wait(child: int, seconds: float) -> int:
    """Return a child's exit code; one that takes too long prints where it is, and is killed."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    os.kill(child, signal.SIGUSR1)
    time.sleep(0.5)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return HUNG

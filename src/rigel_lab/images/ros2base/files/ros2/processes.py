"""Processes that are started together and stopped together."""

import signal
import subprocess
import sys
import threading
import time

#: Seconds between SIGINT, SIGTERM and SIGKILL, as upstream does it.
PATIENCE = 5.0
_STEPS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


class Process:
    """One process; its output gets its name in front."""

    def __init__(self, name, command):
        self.name, self.command = name, command

    def start(self, number):
        self.label = f"{self.name}-{number}"
        self.popen = subprocess.Popen(
            self.command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,  # a terminal's ^C comes from us, once
        )
        say(f"[INFO] [{self.label}]: process started with pid [{self.popen.pid}]")
        self.reader = threading.Thread(target=self._print, daemon=True)
        self.reader.start()

    def _print(self):
        for line in self.popen.stdout:
            say(f"[{self.label}] {line.rstrip()}")

    def ended(self):
        return self.popen.poll() is not None


def supervise(processes):
    """Start all, stop all on a signal; returns the exit code: 1 if one of them failed."""
    asked = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked.append(time.monotonic()))
    for number, process in enumerate(processes, 1):
        process.start(number)
    sent = 0
    while not all(process.ended() for process in processes):
        if asked and sent < len(_STEPS) and time.monotonic() >= asked[0] + sent * PATIENCE:
            _send(processes, _STEPS[sent])
            sent += 1
        time.sleep(0.05)
    for process in processes:
        process.reader.join(1.0)
    return _outcome(processes, bool(asked))


def _send(processes, number):
    for process in processes:
        if not process.ended():
            say(f"[INFO] [{process.label}]: sending signal '{signal.Signals(number).name}'")
            process.popen.send_signal(number)


def _outcome(processes, asked):
    code = 0
    for process in processes:
        ended = process.popen.returncode
        say(f"[{'ERROR' if ended else 'INFO'}] [{process.label}]: exit code {ended}")
        code = 1 if ended and not asked else code
    return code


def say(line):
    sys.stdout.write(line + "\n")
    sys.stdout.flush()

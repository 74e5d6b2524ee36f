"""Ctrl-C and SIGTERM let work end in good order, a second one ends the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from rigel_k8s.commands.interruption import interruptible

pytestmark = pytest.mark.programs

SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
#: Sends itself a signal while the module of the command line's first library is looked for.
IMPORTING = """
import os, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "click":
            os.kill(os.getpid(), {number})
sys.meta_path.insert(0, Finder())
from rigel_k8s.entry import main
main(name="rigel")
"""
#: Sends itself a signal twice while it does something that does not listen.
TWICE = """
import os, time
from rigel_k8s import signals
from rigel_k8s.commands.interruption import interruptible
signals.handle(signals.raise_interrupt)
with interruptible() as cancel:
    os.kill(os.getpid(), {number})
    assert cancel.wait(20)
    os.kill(os.getpid(), {number})
    time.sleep(600)
"""
#: Sends itself a signal in a command that asks for no good end.
PLAIN = """
import os, sys
from rigel_k8s import entry
from rigel_k8s.commands import doctor
from rigel_k8s.cli import main
main.cli.main = lambda **_: os.kill(os.getpid(), {number})
entry.main(name="rigel")
"""
#: Sends itself a signal in a plain command, and another one while that cleans up.
PLAIN_TWICE = """
import os, time
from rigel_k8s import signals
signals.handle(signals.raise_interrupt)
try:
    os.kill(os.getpid(), {number})
finally:
    os.kill(os.getpid(), {number})
    time.sleep(600)
"""


def run(code: str, number: int) -> tuple[int, str]:
    """Return the exit code and standard error of a program that sends itself a signal."""
    words = [sys.executable, "-c", code.format(number=int(number))]
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=120)
    return done.returncode, done.stderr


def test_the_first_asks() -> None:
    with interruptible() as cancel:
        assert not cancel.is_set()
        os.kill(os.getpid(), signal.SIGINT)
        assert cancel.wait(10)


@SIGNALS
def test_the_second_ends_at_once_with_one_line(number: int) -> None:
    code, said = run(TWICE, number)
    assert code == 128 + number
    assert said == (
        "error: interrupted twice, stopped without waiting; "
        "run the same command again to complete its work\n"
    )


@SIGNALS
def test_a_signal_while_modules_are_imported_shows_no_traceback(number: int) -> None:
    assert run(IMPORTING, number) == (128 + number, "error: interrupted before anything was done\n")


@SIGNALS
def test_a_signal_in_any_command_shows_no_traceback(number: int) -> None:
    assert run(PLAIN, number) == (128 + number, "interrupted\n")


@SIGNALS
def test_a_second_signal_ends_any_command_at_once(number: int) -> None:
    """It does not interrupt the clean-up half way, which may wait for ever then."""
    assert run(PLAIN_TWICE, number) == (128 + number, "error: interrupted twice\n")


def test_afterwards_ctrl_c_is_pythons_own() -> None:
    """The handlers are as they were."""
    before = signal.getsignal(signal.SIGINT)
    with interruptible():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before

"""Ctrl-C lets work end in good order, a second one ends it."""

from __future__ import annotations

import os
import signal

import pytest

from rigel_k8s.commands.interruption import interruptible


def test_the_first_asks_and_the_second_ends() -> None:
    """The event is set by the first; the second raises."""
    with interruptible() as cancel:
        assert not cancel.is_set()
        os.kill(os.getpid(), signal.SIGINT)
        assert cancel.wait(10)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_afterwards_ctrl_c_is_pythons_own() -> None:
    """The handlers are as they were."""
    before = signal.getsignal(signal.SIGINT)
    with interruptible():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before

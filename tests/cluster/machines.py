"""Machines of a local cluster that end at once, as if their power were cut."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path


def lose(cluster: str, machine: str) -> None:
    """End a machine of a local cluster at once, with all that runs on it."""
    script = f"/clusters/{cluster}/{machine}/init.sh"
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it may have ended meanwhile
            if script in (entry / "cmdline").read_bytes().decode(errors="replace"):
                found.append(int(entry.name))
    assert found, f"{machine} does not run"
    os.kill(min(found), signal.SIGKILL)  # `unshare --kill-child` takes the rest along

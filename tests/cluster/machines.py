"""Machines of a local cluster that lose their power or their network."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


@contextmanager
def cut_off(cluster: str, machine: str) -> Iterator[None]:
    """Take a machine of a local cluster off the network; what runs on it goes on meanwhile."""
    ip = ("ip", "netns", "exec", f"rigel-{cluster}-{machine}", "ip", "-j", "link", "show", "eth0")
    [inside] = json.loads(subprocess.run(ip, check=True, capture_output=True).stdout)
    links = json.loads(subprocess.run(("ip", "-j", "link"), check=True, capture_output=True).stdout)
    [outside] = [one["ifname"] for one in links if one["ifindex"] == inside["link_index"]]
    subprocess.run(("ip", "link", "set", outside, "down"), check=True)
    try:
        yield
    finally:
        subprocess.run(("ip", "link", "set", outside, "up"), check=True)

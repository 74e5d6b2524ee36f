"""The preStop hook in a process namespace of its own: which signal reaches whom, and when."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

import rigel_k8s.inpod

STOP = Path(rigel_k8s.inpod.__file__).parent / "stop.sh"

#: Says which signal it got; `deaf` ones go on after SIGINT.
NODE = """
import signal, sys
def told(number, frame):
    print(sys.argv[1], signal.Signals(number).name, flush=True)
    if "deaf" not in sys.argv[1] or number == signal.SIGTERM:
        sys.exit()
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, told)
print("up", flush=True)
while True:
    signal.pause()
"""
#: Process 1: starts nodes, and prints what they say and what signals it gets itself.
FIRST = """
import signal, subprocess, sys
node, *names = sys.argv[1:]
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda n, _: print("first", signal.Signals(n).name, flush=True))
nodes = [
    subprocess.Popen([sys.executable, "-S", "-c", node, name], stdout=subprocess.PIPE, text=True)
    for name in names
]
assert all(one.stdout.readline() == "up\\n" for one in nodes)
print("up", flush=True)
for one in nodes:
    for line in one.stdout:
        print(line.strip(), flush=True)
sys.stdin.read()
"""


@pytest.fixture
def stopped() -> Callable[..., list[str]]:
    """Run a container of nodes and the hook in it; the lines that it printed."""
    if not (shutil.which("unshare") and shutil.which("nsenter")):
        pytest.skip("no unshare or nsenter (Debian: util-linux)")
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    unshare = ["unshare", *user, "--pid", "--fork", "--kill-child", "--mount-proc"]
    if subprocess.run([*unshare, "true"], capture_output=True).returncode:
        pytest.skip("this machine lets nobody but root make namespaces")

    def run(*names: str, seconds: int = 8) -> list[str]:
        words = [*unshare, sys.executable, "-S", "-c", FIRST, NODE, *names]
        pipe = subprocess.PIPE
        with (
            subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True) as container,
            ExitStack() as cleanup,
        ):
            cleanup.callback(container.kill)
            assert container.stdout is not None
            assert container.stdout.readline() == "up\n"
            children = Path(f"/proc/{container.pid}/task/{container.pid}/children").read_text()
            enter = ["nsenter", f"--target={children.split()[0]}", "--pid", "--mount"]
            enter += ["--user", "--preserve-credentials"] if user else []
            hook = [*enter, "/bin/sh", str(STOP), str(seconds)]  # as `kubectl exec` runs it
            assert subprocess.run(hook, timeout=60).returncode == 0
            return str(container.communicate(timeout=20)[0]).splitlines()

    return run


def test_nodes_get_sigint_and_process_1_gets_it_after_them(stopped: Callable[..., list[str]]):
    """It is what rospy, roscpp and rclpy take leave on; Kubernetes sends SIGTERM to process 1."""
    assert stopped("one", "two") == ["one SIGINT", "two SIGINT", "first SIGINT"]


def test_what_does_not_end_gets_sigterm_after_half_the_time(stopped: Callable[..., list[str]]):
    assert stopped("deaf", seconds=2) == ["deaf SIGINT", "deaf SIGTERM", "first SIGINT"]

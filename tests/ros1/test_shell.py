"""Entering a container: `kubectl exec -it POD -- bash`, and commands run through exec.sh."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import time

import pytest

from tests.support.until import until

from .conftest import PATIENCE

pytestmark = pytest.mark.cluster

EXEC = ("/bin/sh", "/rigel-k8s/exec.sh")
#: A workspace over the base image, as an image's own entry point or command sources it.
SETUP = """. /opt/ros/noetic/setup.sh
export ROS_PACKAGE_PATH=/ws/share:$ROS_PACKAGE_PATH PATH=/ws/bin:$PATH
export TWO_LINES="first \\"x\\"
second = \\$HOME" EMPTY=
"""
TOOL = "#!/bin/sh\necho the workspace tool\n"
FILES = {"/ws/setup.sh": SETUP, "/ws/bin/tool": TOOL}
SLEEPER = ("bash", "-c", ". /ws/setup.sh; exec sleep 1000")
#: Whether a process of the pod shows that its command has sourced the workspace.
SOURCED = ("sh", "-c", "grep -qs '^ROS_PACKAGE_PATH=/ws/' -z /proc/[0-9]*/environ")


def started(pods, *command):
    """A pod with a process that has sourced the workspace."""
    pods.master_uri = pods.master_uri or "http://localhost:11311"
    pod = pods.start("pod", *command, files=FILES)
    until(lambda: pod.exec(*SOURCED).returncode == 0, "the workspace", PATIENCE, last_words=pod.log)
    return pod


def typed(command: list[str], *lines: str) -> str:
    """What a terminal shows when a person types lines into a command that runs on it."""
    mine, its = pty.openpty()
    with subprocess.Popen(command, stdin=its, stdout=its, stderr=its, start_new_session=True) as p:
        os.close(its)
        os.write(mine, "".join(line + "\n" for line in (*lines, "exit")).encode())
        shown, deadline = b"", time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            if select.select([mine], [], [], 0.2)[0]:
                try:
                    shown += os.read(mine, 4096)
                except OSError:  # the last process on the terminal has ended
                    break
        p.kill()
    os.close(mine)
    return re.sub(r"\x1b\[\?2004[hl]\r?", "", shown.decode())


def test_bash(pods):
    """An interactive bash finds rostopic and what the node's workspace brings."""
    pods.roscore()
    pod = started(pods, *SLEEPER)
    shown = typed(pod.entering("bash", env={"TERM": "dumb"}), "rostopic list", "tool")
    assert "/rosout_agg" in shown
    assert "the workspace tool" in shown
    assert "rigel" not in shown


@pytest.mark.parametrize("shell", ["bash", "sh"])
def test_interactive_exec(pods, shell):
    """exec.sh without a command is a shell with the node's environment, also without bash."""
    pod = started(pods, *SLEEPER)
    if shell == "sh":
        pod.exec("rm", "/usr/bin/bash")
    shown = typed(pod.entering(*EXEC, env={"TERM": "dumb"}), "tool", "echo shell is $0")
    assert "the workspace tool" in shown
    assert f"shell is {shell}" in shown


def test_nested_bash_keeps_changes(pods):
    """The environment is taken once: what a person changes afterwards holds in inner shells."""
    pod = started(pods, *SLEEPER)
    lines = ("export ROS_PACKAGE_PATH=/mine", "bash", "echo is:$ROS_PACKAGE_PATH:", "exit")
    assert "is:/mine:" in typed(pod.entering("bash", env={"TERM": "dumb"}), *lines)


def test_values_arrive_unchanged(pods):
    """Values with line ends, quotes, dollars and nothing in them are what the node has."""
    pod = started(pods, *SLEEPER)
    for shell in ("sh", "bash"):
        done = pod.exec(
            shell, "-c", '. /rigel-k8s/rc.sh; printf "%s|" "$TWO_LINES" "${EMPTY-unset}"'
        )
        assert done.stdout == 'first "x"\nsecond = $HOME||'


@pytest.mark.parametrize(
    "command",
    [
        ("bash", "-c", ". /ws/setup.sh; exec sleep 1000"),
        ("bash", "-c", ". /ws/setup.sh; sleep 1000; true"),
        ("sh", "-c", "bash -c '. /ws/setup.sh; sleep 1000; true'; true"),
    ],
    ids=["first", "child", "grandchild"],
)
def test_command(pods, command):
    """A command through exec.sh has the node's environment, whichever process sourced it."""
    pod = started(pods, *command)
    assert pod.exec(*EXEC, "tool").stdout == "the workspace tool\n"
    assert pod.exec("tool").returncode == 127, "found without exec.sh: this test proves nothing"


def test_exit_code(pods):
    """exec.sh ends with the command's exit code and passes its arguments as they are."""
    pod = started(pods, *SLEEPER)
    assert pod.exec(*EXEC, "sh", "-c", "exit 7").returncode == 7
    assert pod.exec(*EXEC, "no-such-command").returncode == 127
    assert pod.exec(*EXEC, "printf", "[%s]", "a b", "*", "$X").stdout == "[a b][*][$X]"


def test_no_node(pods):
    """Where no process shows a ROS environment, the distribution's own set-up is sourced."""
    pods.master_uri = "http://localhost:11311"
    pod = pods.start("pod", "sleep", "100", entrypoint=False)
    assert pod.exec(*EXEC, "printenv", "ROS_PACKAGE_PATH").stdout == "/opt/ros/noetic/share\n"


def test_no_ros(pods):
    """In a container without ROS the command runs all the same."""
    pods.master_uri = ""
    pod = pods.start("pod", "sleep", "100", entrypoint=False, env={"ROS_DISTRO": "none"})
    assert pod.exec(*EXEC, "echo", "hello").stdout == "hello\n"

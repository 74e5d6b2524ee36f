"""The preStop hook in a process namespace of its own: which signal reaches whom, and when."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path

import pytest

import rigel_inpod

pytestmark = pytest.mark.programs

STOP = Path(rigel_inpod.__file__).parent / "stop.sh"

#: Says when it got which signal; `deaf` ones go on after SIGINT, `stubborn` ones after all.
NODE = """
import signal, sys, time
def told(number, frame):
    print(time.monotonic_ns(), sys.argv[1], signal.Signals(number).name, flush=True)
    if "stubborn" not in sys.argv[1] and ("deaf" not in sys.argv[1] or number == signal.SIGTERM):
        sys.exit()
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, told)
print("up", flush=True)
while True:
    signal.pause()
"""
#: Process 1: starts nodes, and prints what they say and what signals it gets itself.
FIRST = """
import os, signal, subprocess, sys, time
node, *names = sys.argv[1:]
def told(number, frame):
    os.write(1, f"{time.monotonic_ns()} first {signal.Signals(number).name}\\n".encode())
    if number == signal.SIGRTMAX:
        os._exit(137)
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGRTMAX):
    signal.signal(number, told)
nodes = [
    subprocess.Popen(
        [sys.executable, name, name] if "/" in name else [sys.executable, "-S", "-c", node, name],
        stdout=subprocess.PIPE,
        text=True,
    )
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
    """Run a container of nodes and the hook in it; who got which signal, in the order of time."""
    if not (shutil.which("unshare") and shutil.which("nsenter")):
        pytest.skip("no unshare or nsenter (Debian: util-linux)")
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    unshare = ["unshare", *user, "--pid", "--fork", "--kill-child", "--mount-proc"]
    if subprocess.run([*unshare, "true"], capture_output=True).returncode:
        pytest.skip("this machine lets nobody but root make namespaces")

    def run(
        *names: str,
        seconds: int | None = 8,
        script: Path = STOP,
        env: Mapping[str, str] | None = None,
    ) -> list[str]:
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
            hook = [*enter, "/bin/sh", str(script)]  # as `kubectl exec` runs it
            hook += [str(seconds)] if seconds else []
            assert (
                subprocess.run(hook, timeout=60, env={**os.environ, **(env or {})}).returncode == 0
            )
            told = [
                line.split(" ", 1) for line in container.communicate(timeout=20)[0].splitlines()
            ]
            return [text for _, text in sorted(told, key=lambda line: int(line[0]))]

    return run


def test_nodes_get_sigint_and_process_1_gets_it_after_them(stopped: Callable[..., list[str]]):
    """It is what rospy, roscpp and rclpy take leave on; Kubernetes sends SIGTERM to process 1."""
    *nodes, last = stopped("one", "two")
    assert (sorted(nodes), last) == (["one SIGINT", "two SIGINT"], "first SIGINT")


def test_what_does_not_end_gets_sigterm_after_half_the_time(stopped: Callable[..., list[str]]):
    assert stopped("deaf", seconds=6) == ["deaf SIGINT", "deaf SIGTERM", "first SIGINT"]


def test_what_ignores_all_signals_is_killed_in_the_pods_own_time(stopped: Callable[..., list[str]]):
    """Where goals may make the end longer: Kubernetes would wait for that, too."""
    env = {"RIGEL_K8S_DRAIN": "300"}
    both = ["stubborn SIGINT", "stubborn SIGTERM"]
    assert stopped("stubborn", seconds=2, env=env) == [*both, "first SIGINT", "first SIGRTMAX"]
    assert stopped("one", seconds=2) == ["one SIGINT", "first SIGINT"]


def test_a_roscore_outlives_the_nodes(stopped: Callable[..., list[str]], tmp_path: Path):
    """They unregister there; it is signalled when they have had their time."""
    roscore = tmp_path / "roscore"
    roscore.write_text(NODE)
    *nodes, last = stopped("one", str(roscore), seconds=4)
    assert nodes == ["one SIGINT", "first SIGINT"]
    assert last.startswith(f"{roscore} SIG")


#: In place of ready.sh: notes how it was called and that the container's node still runs.
READY = """
kill -0 2 2>/dev/null && echo "$* while the node runs" >>"${0%/*}/log" || echo "$*" >>"${0%/*}/log"
exit $(cat "${0%/*}/code")
"""
#: In place of sleep: notes how long.
SLEEP = """#!/bin/sh
echo "sleep $1" >>"${0%/*}/log"
exec /bin/sleep "$1"
"""


@pytest.fixture
def hook(tmp_path: Path) -> Callable[[int], Path]:
    """Make a stop hook whose ready.sh ends with a code; its folder has the log."""

    def make(code: int) -> Path:
        shutil.copy(STOP, tmp_path)
        (tmp_path / "ready.sh").write_text(READY)
        (tmp_path / "code").write_text(str(code))
        (tmp_path / "sleep").write_text(SLEEP)
        (tmp_path / "sleep").chmod(0o755)
        return tmp_path / "stop.sh"

    return make


def log_of(script: Path) -> list[str]:
    return (script.parent / "log").read_text().splitlines()


def env_of(script: Path, workload: str = "talker") -> dict[str, str]:
    path = f"{script.parent}:{os.environ['PATH']}"
    return {"PATH": path, "RIGEL_K8S_WORKLOAD": workload}


@pytest.mark.parametrize(("seconds", "wait"), [(None, 2), (8, 2), (20, 5)])
def test_names_are_handed_over_before_anything_is_signalled(
    stopped: Callable[..., list[str]],
    hook: Callable[[int], Path],
    seconds: int | None,
    wait: int,
):
    """Newcomers have a quarter of the time; then their subscribers have a moment to find them."""
    script = hook(0)
    lines = stopped("one", seconds=seconds, script=script, env=env_of(script))
    assert lines == ["one SIGINT", "first SIGINT"]
    assert log_of(script)[:2] == [f"leave --wait {wait} while the node runs", "sleep 0.5"]


def test_where_no_one_waits_the_nodes_end_at_once(
    stopped: Callable[..., list[str]], hook: Callable[[int], Path]
):
    """Nothing was handed over, or there is no gate, or no Python for the question."""
    for code in (1, 3):
        script = hook(code)
        stopped("one", script=script, env=env_of(script))
        assert "sleep 0.5" not in log_of(script)
        assert log_of(script)[0] == "leave --wait 2 while the node runs"


def test_a_pod_whose_nodes_do_not_hand_over_asks_no_one(
    stopped: Callable[..., list[str]], hook: Callable[[int], Path]
):
    script = hook(0)
    assert stopped("one", script=script, env=env_of(script, "")) == ["one SIGINT", "first SIGINT"]
    assert not [line for line in log_of(script) if line.startswith("leave")]


#: In place of python3: notes how it was called and what works then, and ends as it was told.
PYTHON = """#!/bin/sh
echo "${2##*/} $3 $4 $5, $RIGEL_K8S_EXEC" >>"${0%/*}/log"
kill -0 2 2>/dev/null && echo "the node runs" >>"${0%/*}/log"
exit $(cat "${0%/*}/code")
"""


@pytest.mark.parametrize("code", [0, 1])
def test_a_ros2_pod_hands_over_before_anything_is_signalled(
    stopped: Callable[..., list[str]], hook: Callable[[int], Path], code: int
):
    """As long as goals may take; what was sent has a moment to arrive.

    Its transitions are made only if no other node of its name works, which would make them too.
    """
    script = hook(code)
    for name in ("exec.sh", "rc.sh"):
        shutil.copy(STOP.parent / name, script.parent)
    (script.parent / "python3").write_text(KEEPER)
    (script.parent / "python3").chmod(0o755)
    own = {"PEERS": "talker-pods", "DRAIN": "77", "TRANSITIONS": "/talker shutdown"}
    env = env_of(script) | {f"RIGEL_K8S_{name}": value for name, value in own.items()}
    lines = stopped("one", script=script, env=env)
    assert lines == ["one SIGINT", "first SIGINT"]
    log = log_of(script)
    assert log[0] == "keeper.py leave --wait 77 while the node runs"
    assert ("sleep 0.5" in log) == (code == 0)
    assert any("transitions.py" in line for line in log) == (code == 1)


#: Called in the place of Python; the name of the script has its flags before it.
KEEPER = """#!/bin/sh
while [ "${1#-}" != "$1" ]; do shift; done
kill -0 2 2>/dev/null && echo "${1##*/} $2 $3 $4 while the node runs" >>"${0%/*}/log"
exit $(cat "${0%/*}/code")
"""


def test_the_keeper_is_left_alone(stopped: Callable[..., list[str]], hook: Callable[[int], Path]):
    """It answers for goals until the end, and the hook does not wait for it."""
    script = hook(0)
    names = [str(script.parent / name) for name in ("keeper.py", "rmw.sh")]
    for name in names:
        Path(name).write_text(KEEPS)
    assert stopped("one", *names, script=script) == ["one SIGINT", "first SIGINT"]
    assert not list(script.parent.glob("*.signalled"))


#: Notes a signal beside itself, and says nothing.
KEEPS = """
import os, pathlib, signal, sys
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda *_: pathlib.Path(sys.argv[0] + ".signalled").touch())
print("up", flush=True)
os.close(1)
while True:
    signal.pause()
"""


def test_a_lifecycle_node_makes_its_transitions_before_it_is_signalled(
    stopped: Callable[..., list[str]], hook: Callable[[int], Path]
):
    """In the node's environment, within half of the time."""
    script = hook(0)
    for name in ("exec.sh", "rc.sh"):
        shutil.copy(STOP.parent / name, script.parent)
    (script.parent / "python3").write_text(PYTHON.replace("$5", "$5 $6 $7"))
    (script.parent / "python3").chmod(0o755)
    env = {**env_of(script, ""), "RIGEL_K8S_TRANSITIONS": "/talker deactivate cleanup"}
    lines = stopped("one", seconds=20, script=script, env=env)
    assert lines == ["one SIGINT", "first SIGINT"]
    asked = "transitions.py stop 10 /talker deactivate cleanup, 1"
    assert log_of(script)[:2] == [asked, "the node runs"]

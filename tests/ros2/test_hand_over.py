"""Real nodes hand over to one another, as in two pods of one workload on one machine."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import attrs
import pytest

import rigel_inpod
from rigel_rmw import libraries
from tests.support import ros2_work
from tests.support.ros2_work.judge import Verdict, is_answered, judge
from tests.support.until import until

pytestmark = pytest.mark.cluster

#: How often one takes over from another, and seconds of each goal.
SWITCHES = int(os.environ.get("RIGEL_TEST_SWITCHES", "8"))
GOAL = 1.0
PATIENCE = 60.0
#: The first number of the caller in C, where there are two callers.
FIRST_OF_C = 1_000_000


@attrs.define
class Pod:
    """What stands for a pod: a node, its keeper, and their notes."""

    process: subprocess.Popen[bytes]
    notes: Path
    output: Path

    def state(self) -> str:
        """Return what its keeper has reached."""
        found = self.notes / "progress"
        return found.read_text() if found.exists() else ""

    def wait(self, word: str) -> str:
        """Return its keeper's state once that has a word in it."""
        until(lambda: word in self.state(), f"{word!r} of {self.notes.name}", PATIENCE)
        return self.state()

    def send(self, line: str) -> None:
        """Let its program do something."""
        assert self.process.stdin
        self.process.stdin.write(f"{line}\n".encode())
        self.process.stdin.flush()

    def end(self, number: signal.Signals) -> None:
        """Send a signal to all of its processes."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)


@attrs.define
class Lab:
    """Starts pods on this machine."""

    room: Path
    bin: Path
    pods: list[Pod] = attrs.Factory(list)

    def environ(self, **more: str) -> dict[str, str]:
        path = f"{self.bin}:/usr/bin:/bin"
        udp = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_LOCALHOST_ONLY": "1"}
        domain = os.environ.get("ROS_DOMAIN_ID", "65")
        return {"PATH": path, "HOME": str(self.room), "ROS_DOMAIN_ID": domain, **udp, **more}

    def run(self, name: str, *words: str, **more: str) -> Pod:
        output, notes = self.room / f"{name}.log", self.room / f"notes-{name}"
        with output.open("wb") as file:
            process = subprocess.Popen(
                [*words],
                env=self.environ(RIGEL_RMW=str(notes), **more),
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )
        self.pods.append(Pod(process, notes, output))
        return self.pods[-1]

    def worker(self, number: int, python: str = "python3", **more: str) -> Pod:
        """Start a pod with the worker."""
        program = str(ros2_work.HERE / "worker.py")
        return self.pod("worker", number, python, "-u", program, **more)

    def caller(self, goal: float) -> Pod:
        """Start who calls the worker, with goals of so many seconds."""
        line = (str(self.bin / "python3"), "-u", str(ros2_work.HERE / "caller.py"))
        return self.run("caller", *line, GOAL=str(goal))

    def pod(self, workload: str, number: int, *program: str, **more: str) -> Pod:
        """Start a pod of a workload, as the container of a pod is started."""
        variables = {
            "VERSION": f"v{number}",
            "RIGEL_K8S_WORKLOAD": workload,
            "RIGEL_K8S_POD": f"{workload}-{number}",
            "RIGEL_K8S_PEERS": "127.0.0.1",
            "RIGEL_K8S_PEERS_PORT": "11650",
            **more,
        }
        return self.run(f"v{number}", "/bin/sh", f"{self.room}/rmw.sh", *program, **variables)

    @staticmethod
    def settle(*callers: Pod) -> None:
        """Wait until what is on its way has arrived, and no call is open that may be lost."""
        begun = time.time()
        time.sleep(2.0)
        for one in callers:
            said = one.output.read_text
            until(lambda said=said: is_answered(said(), begun), "answer to a call", PATIENCE)

    def verdict(self, caller: Pod, numbers: Sequence[int] = range(FIRST_OF_C)) -> Verdict:
        """Return what became of the caller's calls, messages and goals, which have such numbers."""
        assert caller.process.poll() is None, caller.output.read_text()
        workers = "".join(read_lines(p) for p in self.pods if p is not caller)
        its = [w for w in workers.splitlines() if w.split()[-1:] and w.split()[-1].isdigit()]
        its = [line for line in its if int(line.split()[-1]) in numbers]
        return judge(read_lines(caller), "\n".join(its))


def read_lines(pod: Pod) -> str:
    """Return its whole lines: it may be about to write another one."""
    text = pod.output.read_text()
    return text[: text.rfind("\n") + 1]


@pytest.fixture
def lab(venv: Callable[[str], Path], tmp_path: Path) -> Iterator[Lab]:
    library = libraries().get(f"rmw-{os.uname().machine}.so")
    if library is None:
        pytest.skip("the layer is not built: it needs ziglang")
    for script in Path(rigel_inpod.__file__).parent.glob("*.*"):
        shutil.copy(script, tmp_path)
    (tmp_path / f"rmw-{os.uname().machine}.so").write_bytes(library)
    made = Lab(tmp_path, venv("work") / "bin")
    yield made
    for pod in made.pods:
        pod.end(signal.SIGKILL)
        pod.process.communicate()


def take_over(old: Pod, new: Pod) -> Pod:
    """Wait until a pod has taken over, end the old one, and return the new one."""
    sys.stdout.write(f"{new.wait('works')}\n")
    time.sleep(0.5)
    old.end(signal.SIGINT)
    with suppress(subprocess.TimeoutExpired):
        old.process.wait(1.0)
    old.end(signal.SIGKILL)
    return new


def test_nothing_is_lost_or_done_twice(lab: Lab) -> None:
    """Messages, calls and goals go on while one worker after another takes over; the last dies."""
    old = lab.worker(1)
    old.wait("works")
    caller = lab.caller(GOAL)
    until(lambda: lab.verdict(caller).goals, "first goal", PATIENCE)
    for number in range(2, SWITCHES + 2):
        old = take_over(old, lab.worker(number))
    lab.settle(caller)
    found = lab.verdict(caller)
    sys.stdout.write(f"{found}\n")
    assert found.faults == {}
    assert len(found.gaps) == SWITCHES

    new = lab.worker(SWITCHES + 2)
    new.wait("took over")
    old.wait("waits")
    since = time.time()
    new.end(signal.SIGKILL)

    def returned() -> float:
        """Return when the one that waits was heard again."""
        lines = [line.split() for line in caller.output.read_text().splitlines()[:-1]]
        heard = [float(w[0]) for w in lines if w[1:3] == ["chat", f"v{SWITCHES + 1}"]]
        return next((when for when in heard if when > since), 0.0)

    gap = until(returned, "message of the one that waits", PATIENCE) - since
    sys.stdout.write(f"works {gap:.2f} s after the other one was killed\n")


def test_a_version_that_is_too_slow_does_not_take_over(lab: Lab) -> None:
    """`readiness: {rates}`: it is measured while it waits, and the old one works on."""
    limits = {"RIGEL_K8S_RATES": "/chatter=5:inf"}
    old = lab.worker(1, RATE="50", **limits)
    until(lambda: (old.notes / "rates").exists(), "rate of the old one", PATIENCE)
    slow = lab.worker(2, RATE="1", **limits)
    probe = (
        "import os, rmw_ready as r\n"
        "try: r.look(os.environ['RIGEL_RMW'], '/worker', True)\n"
        "except r.NotReady as why: print(why)"
    )

    def ask(pod: Pod) -> str:
        notes = {"RIGEL_RMW": str(pod.notes), "PYTHONPATH": str(lab.room)}
        line = [sys.executable, "-c", probe]
        env = lab.environ(**notes, **limits)
        return subprocess.run(line, env=env, capture_output=True, text=True, check=True).stdout

    cause = r"/chatter is published [\d.]+ times per second, not 5/s or more\n"
    until(lambda: re.fullmatch(cause, ask(slow)), "cause", PATIENCE)
    slow.wait("waits to take over from worker-1")
    time.sleep(3)
    assert "waits to take over from worker-1" in slow.state()
    assert ask(old) == ""
    take_over(old, lab.worker(3, RATE="50", **limits))


@pytest.mark.slow
def test_distributions_hand_over(
    lab: Lab, venv: Callable[[str], Path], program: Callable[[str, str], Path]
) -> None:
    """Kilted takes over from jazzy, and back; one of the callers is in C."""
    old = lab.worker(1)
    old.wait("works")
    caller = lab.caller(0.5)
    in_c = lab.run("caller-c", str(program("jazzy", "caller")), FIRST=str(FIRST_OF_C))
    until(lambda: lab.verdict(caller).goals, "first goal", PATIENCE)
    for number, name in enumerate(("work-kilted", "work", "work", "work-kilted", "work"), 2):
        old = take_over(old, lab.worker(number, str(venv(name) / "bin/python3")))
    lab.settle(caller, in_c)
    for found in (lab.verdict(caller), lab.verdict(in_c, range(FIRST_OF_C, 2 * FIRST_OF_C))):
        sys.stdout.write(f"{found}\n")
        assert found.faults == {}
        assert len(found.gaps) == 5
        assert min(found.calls, found.counted) > 100


def test_programs_in_c_hand_over(lab: Lab, program: Callable[[str, str], Path]) -> None:
    """Of jazzy and kilted, with an executor of events, too; containers whose components change."""
    old = lab.pod("worker", 1, str(program("jazzy", "worker")))
    old.wait("works")
    caller = lab.caller(0)
    until(lambda: lab.verdict(caller).calls, "first call", PATIENCE)
    for number, (distro, more) in enumerate((("kilted", "EVENTS=1"), ("jazzy", "A=1")), 2):
        old = take_over(old, lab.pod("worker", number, "env", more, str(program(distro, "worker"))))
    part = ""
    for number, distro in enumerate(("jazzy", "kilted", "jazzy"), 4):
        paths = {name: str(program(distro, name)) for name in ("container", "worker.so", "part.so")}
        components = (paths["worker.so"], f"{paths['part.so']}=a")
        new = lab.pod("worker", number, paths["container"], *components)
        if part:
            old.send(f"renew {part}")
        old, part = take_over(old, new), components[1]
    lab.settle(caller)
    found = lab.verdict(caller)
    sys.stdout.write(f"{found}\n")
    assert found.faults == {}
    assert len(found.gaps) == 5
    assert min(found.calls, found.counted) > 100
    assert not [pod for pod in lab.pods if "still busy" in pod.state()]


def test_a_manager_waits_for_the_nodes_of_its_own_pod(lab: Lab) -> None:
    """It starts before they do, and the old pod's nodes, which have their names, are there."""
    work = ros2_work.HERE
    line = f"""
        python3 -u {work}/manager.py /arm &
        sleep 4
        exec python3 -u {work}/managed.py --ros-args -r __node:=arm
    """
    for number, word in ((1, "works"), (2, "took over")):
        pod = lab.pod("robot", number, "/bin/sh", "-c", line)
        pod.wait(word)
        said = f"v{number} managed"
        until(lambda pod=pod, said=said: said in pod.output.read_text(), said, PATIENCE)


@pytest.fixture
def machines() -> Iterator[list[tuple[str, str]]]:
    """Two machines on one wire: (network namespace, address)."""
    names = [f"t-cut-{os.getpid()}-{n}" for n in (1, 2)]
    made = [(name, f"10.199.0.{n}") for n, name in enumerate(names, start=1)]
    for name, _ in made:
        subprocess.run(["ip", "netns", "add", name], check=True)
    one, other = (["eth0", "netns", name] for name in names)
    try:
        line = ["ip", "link", "add", *one, "type", "veth", "peer", "name", *other]
        subprocess.run(line, check=True)
        for name, address in made:
            subprocess.run(["ip", "-n", name, "link", "set", "eth0", "up"], check=True)
            line = ["ip", "-n", name, "address", "add", f"{address}/24", "dev", "eth0"]
            subprocess.run(line, check=True)
        yield made
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "delete", name], check=True)


def test_a_pod_that_is_cut_off_is_replaced_until_it_is_back(
    machines: list[tuple[str, str]], lab: Lab
) -> None:
    """Nothing ends the connection but the kernel, and both work; then the newer one stays."""
    (here, one), (there, other) = machines
    protocol = lab.room / "handover.py"
    patient = protocol.read_text().replace("SILENT = 10.0", "SILENT = 1000.0")
    assert patient != protocol.read_text()
    protocol.write_text(patient)
    pods = []
    for place, peer in ((here, other), (there, one)):
        number = len(pods) + 1
        line = ["ip", "netns", "exec", place, str(lab.bin / "python3"), "-u"]
        variables = {
            "RIGEL_K8S_WORKLOAD": "worker",
            "RIGEL_K8S_POD": f"worker-{number}",
            "RIGEL_K8S_PEERS": peer,
        }
        (lab.room / f"notes-cut{number}").mkdir()
        pods.append(lab.run(f"cut{number}", *line, f"{lab.room}/keeper.py", "run", **variables))
        pods[-1].wait("take over" if pods[1:] else "works")
    rule = "table inet t { chain c { type filter hook input priority 0; policy drop; }; }"
    subprocess.run(["ip", "netns", "exec", here, "nft", rule], check=True)
    pods[1].wait("works, since worker-1 does not answer")
    assert "works" in pods[0].state()
    subprocess.run(["ip", "netns", "exec", here, "nft", "flush", "ruleset"], check=True)
    pods[0].wait("waits, worker-2 works")

"""The costs of the gate in front of roscore: time of a call, memory; prints a table.

usage: python -m bench.gate --root DIRECTORY [--nodes 100] [--topics 1000] [--calls 2000] [--large]

The directory is the root of a ROS 1 image (`rigel image ros1-base` leaves one in its cache); its
rosmaster runs in it. Calls with and without the gate take turns. With `--large`, it is measured
how long another caller of the gate waits while parameters of up to 16 MiB are set and read.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
import xmlrpc.client
import xmlrpc.server
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

MASTER, GATE, HAND_OVER = 21312, 21311, 21310


@contextlib.contextmanager
def running(*command: str, **env: str) -> Iterator[int]:
    """Run a process; yield its id."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, env={**os.environ, **env}, **quiet) as process:  # type: ignore[call-overload]
        try:
            yield process.pid
        finally:
            process.terminate()


def start_gate(directory: str) -> contextlib.AbstractContextManager[int]:
    """Run a gate whose journal is in a directory; yield its id."""
    words = ["--journal", f"{directory}/journal", "--port", GATE, "--hand-over-port", HAND_OVER]
    line = [sys.executable, "-S", "-m", "rigel_gate", *words, "--master-port", MASTER]
    source = str(Path(__file__).parents[1] / "src")
    return running(*map(str, line), PYTHONPATH=source)


def start_master(root: Path) -> contextlib.AbstractContextManager[int]:
    """Run rosmaster in the root of a ROS 1 image; yield its id."""
    words = ["/opt/ros/noetic/bin/rosmaster", "--core", "-p", str(MASTER), "-w", "10"]
    own = {"ROS_ROOT": "/opt/ros/noetic/share/ros", "HOME": "/tmp", "ROS_MASTER_URI": ""}
    return running("chroot", str(root), "python3", *words, **own)


def connect(port: int) -> xmlrpc.client.ServerProxy:
    """Return a master's API."""
    return xmlrpc.client.ServerProxy(f"http://127.0.0.1:{port}")


def until_answers(port: int) -> None:
    """Wait until a master answers."""
    for _ in range(200):
        with contextlib.suppress(OSError, xmlrpc.client.Error):
            connect(port).getPid("/bench")
            return
        time.sleep(0.05)
    raise SystemExit(f"nothing answers at port {port}")


def serve_node() -> str:
    """Start the slave API that all nodes of the bench share; return its URI."""
    server = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
    server.register_function(lambda *_: [1, "", 0], "publisherUpdate")
    server.register_function(lambda *_: [1, "", 0], "shutdown")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_address[1]}/"


def fill(port: int, uri: str, nodes: int, topics: int) -> None:
    """Register nodes that publish topics."""
    master = connect(port)
    for number in range(topics):
        name = f"/node_{number % nodes}"
        master.registerPublisher(name, f"/topic_{number}", "std_msgs/String", uri)


def measure(calls: dict[str, Callable[[int], object]], count: int) -> dict[str, list[float]]:
    """Return the milliseconds of each call, made in turn."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(count):
        for name, call in calls.items():
            started = time.perf_counter()
            call(number)
            times[name].append(1000 * (time.perf_counter() - started))
    return times


def large_values() -> dict[str, object]:
    """Return values that are about as large as a call may be."""
    return {
        "450,000 numbers": list(range(450_000)),
        "100,000 names": {f"name_{number}": number for number in range(100_000)},
        "150,000 lists": [[number] for number in range(150_000)],
        "60,000 structs": [{"x": number, "y": 0.5} for number in range(60_000)],
        "a text of 15 MiB": "x" * (15 * 2**20),
        "11 MiB of bytes": xmlrpc.client.Binary(bytes(11 * 2**20)),
    }


def measure_large(turns: int = 5) -> None:
    """Print how long a call waits that the gate answers itself, while large ones are answered."""
    print("| value | seconds to set | to read | longest wait of another, ms |\n|---|---|---|---|")
    for name, value in large_values().items():
        body = xmlrpc.client.dumps(("/bench", "/large", value), "setParam").encode()
        waits: list[float] = []
        end = threading.Event()

        def ask(waits: list[float] = waits, end: threading.Event = end) -> None:
            other = connect(GATE)
            while not end.wait(0.002):
                started = time.perf_counter()
                other.getUri("/bench")
                waits.append(1000 * (time.perf_counter() - started))

        thread = threading.Thread(target=ask)
        thread.start()
        times: list[list[float]] = []
        for _ in range(turns):
            request = urllib.request.Request(f"http://127.0.0.1:{GATE}", body)
            started = time.perf_counter()
            urllib.request.urlopen(request).read()
            middle = time.perf_counter()
            read = xmlrpc.client.dumps(("/bench", "/large"), "getParam").encode()
            urllib.request.urlopen(f"http://127.0.0.1:{GATE}", read).read()
            times.append([middle - started, time.perf_counter() - middle])
        time.sleep(2)  # the gate writes its file again
        end.set()
        thread.join()
        took = [median(found) for found in zip(*times, strict=True)]
        print(f"| {name} | {took[0]:.2f} | {took[1]:.2f} | {max(waits):.0f} |", flush=True)


def memory(pid: int) -> float:
    """Return the MiB that a process and its children use; shared memory counts once."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    total = 0
    for one in (str(pid), *children):
        for line in Path(f"/proc/{one}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                total += int(line.split()[1])
    return total / 1024


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--nodes", type=int, default=100)
    parser.add_argument("--topics", type=int, default=1000)
    parser.add_argument("--calls", type=int, default=2000)
    parser.add_argument("--large", action="store_true")
    words = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as directory,
        start_master(words.root),
        start_gate(directory) as pid,
    ):
        until_answers(MASTER)
        until_answers(GATE)
        if words.large:
            measure_large()
            return
        uri = serve_node()
        fill(GATE, uri, words.nodes, words.topics)
        direct, through = connect(MASTER), connect(GATE)
        topic = "/bench_topic"
        args = ("/bench", topic, "std_msgs/String", uri)
        times = measure(
            {
                "lookupNode": lambda n: direct.lookupNode("/bench", f"/node_{n % words.nodes}"),
                "lookupNode, gate": lambda n: through.lookupNode(
                    "/bench", f"/node_{n % words.nodes}"
                ),
                "registerPublisher": lambda _: direct.registerPublisher(*args),
                "registerPublisher, gate": lambda _: through.registerPublisher(*args),
            },
            words.calls,
        )
        print(f"\n{words.nodes} nodes, {words.topics} topics\n")
        print("| call | median ms | 99 % ms |\n|---|---|---|")
        for name, found in times.items():
            late = sorted(found)[len(found) * 99 // 100]
            print(f"| {name} | {median(found):.2f} | {late:.2f} |")
        print(f"\nmemory of the gate: {memory(pid):.1f} MiB")


if __name__ == "__main__":
    main()

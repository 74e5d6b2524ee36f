"""A program of this computer that talks to a pod: `rigel join` beside `kubectl port-forward`.

usage: python -m bench.join --context NAME --image IMAGE [--megabytes 64] [--runs 3]

IMAGE has Python 3. Each way starts a client that sends as much, receives as much and makes 200
round trips; ways take turns. The time to start is from the command to the client's connection.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from rigel_lab import cluster as lab

NAMESPACE, PORT = "bench-join", 7000
#: First a letter: u takes bytes and answers, d sends some, as many as a number says; e echoes.
SERVER = """
import socket, threading
def serve(one):
    with one:
        kind = one.recv(1)
        if kind == b"u":
            left = int(one.recv(20))
            while left > 0: left -= len(one.recv(1 << 18))
            one.sendall(b".")
        if kind == b"d":
            left = int(one.recv(20))
            while left > 0:
                one.sendall(bytes(1 << 16)); left -= 1 << 16
        while kind == b"e" and (data := one.recv(1000)): one.sendall(data)
with socket.create_server(("", 7000)) as server:
    while True: threading.Thread(target=serve, args=(server.accept()[0],), daemon=True).start()
"""
CLIENT = """
import json, socket, statistics, sys, time
host, port, size, begun = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
def connect(kind):
    end = time.time() + 30
    while True:
        try: one = socket.create_connection((host, port), 30); break
        except OSError:
            if time.time() > end: raise
            time.sleep(0.02)
    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    one.sendall(kind)
    return one
one = connect(b"e"); one.sendall(b"x" * 100); one.recv(1000)
found = {"start": time.time() - begun}
trips = []
for _ in range(200):
    at = time.perf_counter(); one.sendall(b"x" * 100); one.recv(1000)
    trips.append(time.perf_counter() - at)
found["trip"] = 1000 * statistics.median(trips)
at = time.perf_counter(); one = connect(b"u"); one.sendall(b"%020d" % size)
for _ in range(size >> 16): one.sendall(bytes(1 << 16))
assert one.recv(1) == b"."
found["up"] = size / (time.perf_counter() - at) / 1e6
at = time.perf_counter(); one = connect(b"d"); one.sendall(b"%020d" % size)
got = 0
while data := one.recv(1 << 18): got += len(data)
assert got >= size
found["down"] = size / (time.perf_counter() - at) / 1e6
print(json.dumps(found))
"""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--context", required=True)
    parser.add_argument("--image", required=True)
    parser.add_argument("--megabytes", type=int, default=64)
    parser.add_argument("--runs", type=int, default=3)
    words = parser.parse_args()
    kubectl = [lab.status(words.context.removeprefix("rigel-")).kubectl, "-n", NAMESPACE]
    kubectl += ["--context", words.context]
    with tempfile.TemporaryDirectory() as directory:
        place = deploy(Path(directory), words.context, words.image)
        pod = read(*kubectl, "get", "pod", "-o", "name", "-l", "app.kubernetes.io/name=server")
        address = read(*kubectl, "get", pod, "-o", "jsonpath={.status.podIP}")
        size = words.megabytes << 20
        ways: dict[str, Callable[[], dict[str, float]]] = {
            "kubectl port-forward": lambda: forward([*kubectl, "port-forward", pod], size),
            "rigel join": lambda: join([*place, "join", "--"], address, size),
        }
        found: dict[str, list[dict[str, float]]] = {name: [] for name in ways}
        for _ in range(words.runs):
            for name, way in ways.items():
                found[name].append(way())
        subprocess.run([*place, "down", "-y"], check=True)
    show(found)


def deploy(directory: Path, context: str, image: str) -> list[str]:
    """Deploy the server, and return the words of a command on it."""
    nodes = {"server": {"args": ["python3", "-c", SERVER], "readiness": "none"}}
    options = {"image": image, "namespace": NAMESPACE, "network": "peers", "nodes": nodes}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
    (directory / "Rigelfile").write_text(json.dumps(whole))
    rigel = [sys.executable, "-m", "rigel_k8s", "-f", str(directory / "Rigelfile")]
    rigel += ["--context", context]
    subprocess.run([*rigel, "run", "job", "deploy"], check=True)
    return rigel


def read(*words: str) -> str:
    """Return what a command prints."""
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


def forward(words: list[str], size: int) -> dict[str, float]:
    """Measure through a forwarded port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    begun = str(time.time())
    with subprocess.Popen([*words, f"{port}:{PORT}"], stdout=subprocess.DEVNULL) as forwarding:
        try:
            line = [sys.executable, "-c", CLIENT, "127.0.0.1", port, str(size), begun]
            return dict(json.loads(read(*line)))
        finally:
            forwarding.terminate()


def join(words: list[str], address: str, size: int) -> dict[str, float]:
    """Measure from the pod's network."""
    begun = str(time.time())
    line = [sys.executable, "-c", CLIENT, address, str(PORT), str(size), begun]
    return dict(json.loads(read(*words, *line)))


def show(found: dict[str, list[dict[str, float]]]) -> None:
    """Print the medians, and their ratios to the first way."""
    columns = {"start": "start s", "trip": "round trip ms", "up": "up MB/s", "down": "down MB/s"}
    print("| way | " + " | ".join(columns.values()) + " |\n|---|---|---|---|---|")
    first: dict[str, float] = {}
    for name, runs in found.items():
        middle = {column: median(run[column] for run in runs) for column in columns}
        first = first or middle
        cells = [f"{middle[c]:.2f} ({middle[c] / first[c]:.2f})" for c in columns]
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()

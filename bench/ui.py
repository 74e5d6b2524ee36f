"""What `rigel ui` costs, and how soon it shows a crash: on a real release, in a real browser.

usage: python -m bench.ui --context NAME --image ROS1_IMAGE [--runs 10] [--seconds 60]

It deploys a talker and a listener into a namespace of its own, which it deletes at the end.
Processor time is that of the processes, from /proc, in percent of one core.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rigel_k8s.kube import connect
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Settings
from tests.support.browser import Browser, Tab, run_browser
from tests.support.page import fill, node, serve_page, topic

NAMESPACE = "bench-ui"
TICK = os.sysconf("SC_CLK_TCK")
TALKER = """
import os, sys, rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("/chatter", std_msgs.msg.String, queue_size=10)
while not rospy.is_shutdown():
    if os.path.exists("/tmp/crash"):
        sys.exit("crashed on purpose")
    publisher.publish("hello")
    rospy.loginfo("hello")
    rospy.rostime.wallsleep(0.05)
"""
LISTENER = """
import rospy, std_msgs.msg
rospy.init_node("listener")
rospy.Subscriber("/chatter", std_msgs.msg.String, lambda message: None)
rospy.spin()
"""
READY, CRASHED = (
    f"document.querySelector('[data-box=\"/talker\"].{s}')" for s in ("ready", "crashed")
)


def main() -> None:
    """Measure and print."""
    words = arguments()
    rigel = [sys.executable, "-m", "rigel_k8s", "--context", words.context, "-n", NAMESPACE]
    with (
        tempfile.TemporaryDirectory() as directory,
        connect(Settings(context=words.context)) as cluster,
    ):
        file = write(Path(directory), words.image)
        home = ObjectRef("v1", "Namespace", "", NAMESPACE)
        cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": NAMESPACE}})
        try:
            subprocess.run([*rigel, "-f", file, "run", "job", "deploy"], check=True)
            with run_browser() as browser, serve(rigel, file) as (address, process):
                print(f"\nfrom the end of a container to a red node, {words.runs} times:")
                show_seconds(list(crash(browser, cluster, address, words.runs)))
                print(f"\n| pages | log | rigel ui, % | Chromium, % |  ({words.seconds} s each)")
                print("|---|---|---|---|")
                for count, log in ((0, False), (1, False), (10, False), (10, True)):
                    row = cost(browser, address, process.pid, count, words.seconds, log=log)
                    print(row, flush=True)
                draw_hundred(browser)
        finally:
            cluster.delete(home)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.ui", description=__doc__)
    parser.add_argument("--context", required=True, help="of a cluster")
    parser.add_argument("--image", required=True, help="a ROS 1 image that its machines can pull")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seconds", type=int, default=60)
    return parser.parse_args()


def write(directory: Path, image: str) -> str:
    """Write the Rigelfile."""
    nodes = {
        "talker": {"args": ["python3", "-c", TALKER]},
        "listener": {"args": ["python3", "-c", LISTENER]},
    }
    options = {"namespace": NAMESPACE, "image": image, "ros_master_image": image, "nodes": nodes}
    jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}}
    file = directory / "Rigelfile"
    file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
    return str(file)


@contextmanager
def serve(rigel: list[str], file: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run `rigel ui`."""
    command = [*rigel, "-f", file, "ui", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout
    try:
        yield process.stdout.readline().strip(), process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


def crash(browser: Browser, cluster: object, address: str, runs: int) -> Iterator[float]:
    """Yield the seconds from a crash to a red node."""
    tab = browser.open(address)
    for _ in range(runs):
        tab.wait(READY, "a talker", 120)
        labels = {"app.kubernetes.io/name": "talker"}
        [pod] = cluster.list("v1", "Pod", NAMESPACE, labels=labels)  # type: ignore[attr-defined]
        container = pod["spec"]["containers"][0]["name"]
        command = ["touch", "/tmp/crash"]
        cluster.run(NAMESPACE, pod["metadata"]["name"], command, container=container)  # type: ignore[attr-defined]
        begun = time.monotonic()
        tab.wait(CRASHED, "a crash", 60)
        yield time.monotonic() - begun
        # A pod that crashes again and again is started later each time.
        ref = ObjectRef("v1", "Pod", NAMESPACE, pod["metadata"]["name"])
        cluster.delete(ref, grace_seconds=0)  # type: ignore[attr-defined]
    tab.close()


def show_seconds(found: list[float]) -> None:
    """Print how long something took."""
    median = statistics.median(found)
    print(f"median {median:.2f} s, shortest {min(found):.2f} s, longest {max(found):.2f} s")


def cost(browser: Browser, address: str, pid: int, count: int, seconds: int, *, log: bool) -> str:
    """Return the processor time that some open pages take, as a row."""
    tabs = [browser.open(f"{address}#node=talker" if log else address) for _ in range(count)]
    for tab in tabs:
        tab.wait(READY, "a talker", 60)
    time.sleep(5)  # what opening them has cost is over
    before = ticks([pid]), ticks(family(browser.pid))
    time.sleep(seconds)
    after = ticks([pid]), ticks(family(browser.pid))
    for tab in tabs:
        tab.close()
    ui, chromium = ((b - a) / TICK / seconds * 100 for a, b in zip(before, after, strict=True))
    return f"| {count} | {'20 lines/s' if log else '-'} | {ui:.1f} | {chromium:.1f} |"


def ticks(pids: list[int]) -> int:
    """Return the processor time of some processes."""
    return sum(sum(map(int, read_stat(pid)[11:13])) for pid in pids)


def family(pid: int) -> list[int]:
    """Return a process with all that it has started."""
    parents = {int(p.name): p for p in Path("/proc").iterdir() if p.name.isdigit()}
    found = [pid]
    for one in found:
        found += [child for child in parents if read_stat(child)[1:2] == [str(one)]]
    return found


def read_stat(pid: int) -> list[str]:
    """Return what /proc says of a process from its state on; nothing where it has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def draw_hundred(browser: Browser) -> None:
    """Print how long the page takes for 100 nodes on ten machines, and for a change of one."""
    names = [f"/unit_{i % 10}/node_{i:03}" for i in range(100)]
    nodes = [node(name, machine=f"machine-{i // 10}") for i, name in enumerate(names)]
    topics = [
        topic(f"/topic_{i:03}", [name], [names[(i * 7 + 3) % 100], names[(i + 1) % 100]])
        for i, name in enumerate(names)
    ]
    with serve_page() as served:
        tab = browser.open(served.address)
        tab.wait("document.querySelector('#graph .note')", "an empty page")
        begun = time.monotonic()
        fill(served.feed, nodes, topics)
        tab.wait("document.querySelectorAll('.box').length === 100", "the nodes")
        tab.wait("document.querySelectorAll('.topic').length === 100", "the topics")
        whole = time.monotonic() - begun
        changed = {**nodes[50], "state": "crashed"}
        entries = {f"node/{one['workload']}": one for one in [*nodes[:50], changed, *nodes[51:]]}
        begun = time.monotonic()
        served.feed.publish("node", entries)
        wait_for(tab, "document.querySelector('.box.crashed')")
        change = time.monotonic() - begun
        print(f"\n100 nodes, 100 topics: drawn in {whole:.2f} s, a change of one in {change:.2f} s")
        tab.close()


def wait_for(tab: Tab, expression: str) -> None:
    """Wait without the pause of the tests."""
    pause = threading.Event()
    while not tab.read(f"Boolean({expression})"):
        pause.wait(0.005)


if __name__ == "__main__":
    main()

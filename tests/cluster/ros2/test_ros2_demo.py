"""Canonical's talkers and listener on real ROS 2, over a second network: what is promised of them.

The pod network of the local cluster carries no multicast between pods: what arrives came over net1,
and a test takes net1 down to see it.
"""

from __future__ import annotations

import json
import re
import secrets
import shlex
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.refs import ObjectRef
from tests.support.takeovers import assert_took_over, longest_gap
from tests.support.until import until

from ...ros2.conftest import environment
from ..background import Background
from ..conftest import pod_uids
from .conftest import EXAMPLES

pytestmark = pytest.mark.cluster

TALKERS = {"talker_1", "talker_2"}
ECHO = "timeout 60 ros2 topic echo --once /from_laptop std_msgs/msg/String"


@pytest.fixture(scope="module")
def demo(project: Callable[..., Any], ros2_image: str, multus: None) -> Any:
    """The example as it is, after `rigel run sequence demo` has gone through once."""
    made = project("ros2-talker-listener", ros2_image)
    made("run", "sequence", "demo")
    return made


def test_both_talkers_are_heard_from_other_machines(demo: Any) -> None:
    """One ROS node a pod, one container a pod, three machines; both names in the listener's log."""
    assert set(demo.pods()) == {"talker-1", "talker-2", "listener"}
    assert len(set(demo.machines().values())) == 3
    assert all(len(pod["spec"]["containers"]) == 1 for pod in demo.pods().values())
    demo.until(lambda: demo.talkers() == TALKERS, "messages of both")


def assert_a_new_message_arrives(demo: Any, talker: str) -> None:
    """Set a parameter that the talker puts into its messages, and find it in the listener's log."""
    nonce = f"n{secrets.token_hex(8)}"
    demo("param", "set", talker, "nonce", nonce)
    demo.until(lambda: nonce in demo("logs", "listener", "--tail", "30").stdout, "the nonce")


def test_status_shows_who_is_discovered_over_what(demo: Any) -> None:
    """As a table for people, as JSON for scripts: interface, address, discovered by all others."""
    address = demo.net1()["talker-1"]
    row = rf"talker-1 .* net1 +{re.escape(address)} +2/2"

    def status(*words: str) -> str:
        """What is told if all is well: a busy node may not be discovered within one look."""
        done = demo("status", *words, check=False)
        return done.stdout if done.returncode == 0 else ""

    def is_ok() -> bool:
        told = status("-o", "json")
        return bool(told) and json.loads(told)["graph"]["ok"] is True

    demo.until(lambda: re.search(row, status()), row)
    demo.until(is_ok, "graph that is ok")


def test_a_listener_without_net1_is_deaf(demo: Any) -> None:
    """Messages come over net1 and nowhere else; with net1 they come again."""
    demo.until(lambda: demo.talkers() == TALKERS, "messages of both")
    demo.link("listener", "net1", "down")
    try:
        demo.until(lambda: is_silent(demo), "silence without net1")  # some may be on the way
    finally:
        demo.link("listener", "net1", "up")
    demo.until(lambda: demo.talkers() == TALKERS, "messages of both")


def is_silent(demo: Any) -> bool:
    """Return whether nothing arrives for four seconds, in which twenty messages are sent."""
    last = demo.heard()[-1]
    time.sleep(4)
    return bool(demo.heard()[-1] == last)


def test_a_rescheduled_talker_is_heard_again(demo: Any) -> None:
    """Another pod, perhaps with another address on net1."""
    before = demo.pods()["talker-1"]["metadata"]
    demo.cluster.delete(ObjectRef("v1", "Pod", demo.space, before["name"]))
    demo.until(lambda: demo.net1().get("talker-1"), "new pod with net1")
    assert demo.pods()["talker-1"]["metadata"]["uid"] != before["uid"]
    demo.until(lambda: is_ready(demo.pods()["talker-1"]), "new pod that is ready")
    assert_a_new_message_arrives(demo, "talker_1")


def test_a_talker_is_developed(demo: Any, tmp_path: Path) -> None:
    """`rigel dev`: the listener hears what is saved here, from the same pod; then as before."""
    script = tmp_path / "talker.py"
    written = (EXAMPLES / "ros2-talker-listener/talker_listener/scripts/talker.py").read_text()
    script.write_text(written)
    before = pod_uids(demo.cluster, demo.space)
    words = ("dev", "talker_1", "--sync", f"{tmp_path}:/opt/talker_listener/scripts")
    with Background(demo.command(*words)) as running:
        until(lambda: running.found("hello world from talker_1"), "its first message", 240)
        developed = pod_uids(demo.cluster, demo.space)
        script.write_text(written.replace("hello world", "good morning"))
        until(
            lambda: "good morning from talker_1" in demo("logs", "listener").stdout, "change", 240
        )
        demo.until(lambda: "talker_2" in demo.talkers(), "the other one")
        assert pod_uids(demo.cluster, demo.space) == developed
    changed = before.items() ^ pod_uids(demo.cluster, demo.space).items()
    assert {name for name, _ in changed} == {"talker-1"}
    assert_a_new_message_arrives(demo, "talker_1")


#: A node on another computer: hears both talkers over multicast, and is heard.
LAPTOP = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("laptop")
node.create_subscription(String, "/chatter", lambda m: print("heard", m.data, flush=True), 10)
publisher = node.create_publisher(String, "/from_laptop", 10)
node.create_timer(0.2, lambda: publisher.publish(String(data="hi")))
rclpy.spin(node)
"""


def test_a_node_of_another_computer_joins(demo: Any) -> None:
    """Over net1, as a pod: `rigel join`."""
    python = str(environment("work") / "bin" / "python3")
    with Background(demo.command("join", "--", python, "-c", LAPTOP)) as running:
        for talker in TALKERS:
            until(lambda name=talker: running.found(f"heard hello world from {name}"), talker, 240)
        heard = demo("exec", "listener", "--", *shlex.split(ECHO)).stdout
        assert heard == "data: hi\n---\n"
        assert running.found(r"^joined as \S+ \(eth0\), \S+ \(net1\)$")


def test_a_computer_that_is_killed_leaves_no_pod(demo: Any) -> None:
    """The pod ends after 30 s without a sign of life, and the next `rigel join` deletes it."""

    def list_joined() -> dict[str, str]:
        labels = {"app.kubernetes.io/name": "rigel-join"}
        found = demo.cluster.list("v1", "Pod", demo.space, labels=labels)
        return {one["metadata"]["name"]: one["status"]["phase"] for one in found}

    with Background(demo.command("join", "--", "sleep", "1000")) as running:
        until(lambda: running.found(r"^joined as "), "its address", 240)
        (killed,) = list_joined()
        running.interrupt(signal.SIGKILL)
    until(lambda: list_joined() == {killed: "Succeeded"}, "end of its pod", 120)
    assert demo("join", "--", "sh", "-c", "exit 7", check=False).returncode == 7
    assert list_joined() == {}


def test_a_program_of_another_computer_takes_a_nodes_place(demo: Any) -> None:
    """`--replace`: the node has no pod meanwhile; then it runs as before, and the others too."""
    python = str(environment("work") / "bin" / "python3")
    script = EXAMPLES / "ros2-talker-listener/talker_listener/scripts/talker.py"
    program = script.read_text().replace("hello world", "good evening")
    own = ("--ros-args", "-r", "__node:=talker_1")
    before = pod_uids(demo.cluster, demo.space)
    words = ("join", "--replace", "talker_1", "--", python, "-c", program, *own)
    with Background(demo.command(*words)):
        text = "good evening from talker_1"
        until(lambda: text in demo("logs", "listener").stdout, text, 240)
        assert "talker-1" not in pod_uids(demo.cluster, demo.space)
        assert "talker_1 is replaced by a program of" in demo("status", check=False).stdout
    changed = before.items() ^ pod_uids(demo.cluster, demo.space).items()
    assert {name for name, _ in changed} == {"talker-1"}
    assert_a_new_message_arrives(demo, "talker_1")


def test_the_update_replaces_the_talkers_alone(demo: Any) -> None:
    """A new content under the same tag is another digest; the listener hears on meanwhile."""
    before, begun = demo.pods(), time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime())
    demo("run", "sequence", "update")
    # Not with --since: another test may have installed Loki, which is behind on a busy machine.
    lines = demo("logs", "listener", "--timestamps").stdout.splitlines()
    heard = "\n".join(line for line in lines if line > begun)
    for talker in TALKERS:
        said = demo("logs", talker, "--timestamps").stdout
        assert_took_over(heard, said, f"hello world from {talker}")
        assert "s; the longest time without one: " in longest_gap(EXAMPLES, heard, talker)
    after = demo.pods()
    changed = {n for n in after if after[n]["metadata"]["uid"] != before[n]["metadata"]["uid"]}
    assert changed == {"talker-1", "talker-2"}
    assert "VERSION=2" in demo("exec", "talker_1", "--", "env").stdout.splitlines()


def test_down_leaves_nothing(demo: Any) -> None:
    """No workload, attachment, ConfigMap or Lease of the release stays."""
    demo("down")
    kinds = [("apps/v1", "Deployment"), ("v1", "Service"), ("v1", "Secret")]
    kinds += [("coordination.k8s.io/v1", "Lease")]
    kinds += [("k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition")]
    left = [o for api, kind in kinds for o in demo.cluster.list(api, kind, demo.space)]
    assert left == []
    maps = [o["metadata"]["name"] for o in demo.cluster.list("v1", "ConfigMap", demo.space)]
    assert maps == ["kube-root-ca.crt"]

"""The demo of the README: built, pushed, deployed, delivering across machines; then its update."""

from __future__ import annotations

import json
import os
import re
import secrets
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from tests.support.takeovers import assert_took_over, longest_gap
from tests.support.until import until

pytestmark = [pytest.mark.cluster, pytest.mark.story]

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros1-talker-listener"
Demo = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def space(cluster: Any) -> Iterator[str]:
    """A namespace for all tests of this file: the demo is deployed once."""
    name = "t-demo"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    yield name
    cluster.delete(ObjectRef("v1", "Namespace", "", name))


@pytest.fixture(scope="module")
def demo(context: str, registry: str, base_image: str, space: str) -> Demo:
    """Run rigel on the example, after `rigel run sequence demo` has gone through once."""

    def call(*words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "rigel_k8s", "-f", str(EXAMPLE / "Rigelfile")]
        done = subprocess.run(
            [*command, "--context", context, "-n", space, *words],
            env={**os.environ, "REGISTRY": registry, "BASE_IMAGE": base_image},
            capture_output=True,
            text=True,
            check=False,
            timeout=600,
        )
        if check:
            assert done.returncode == 0, done.stdout + done.stderr
        return done

    call("run", "sequence", "demo")
    return call


def pods(cluster: Any, space: str) -> dict[str, dict[str, Any]]:
    """Return the namespace's pods by their workload."""
    return {
        pod["metadata"]["labels"]["app.kubernetes.io/name"]: pod
        for pod in cluster.list("v1", "Pod", space)
        if not pod["metadata"].get("deletionTimestamp")
    }


def test_talker_and_listener_are_on_different_machines(
    demo: Demo, cluster: Any, space: str
) -> None:
    """`apart_from` puts them apart, so that messages do cross the network."""
    found = pods(cluster, space)
    assert set(found) == {"ros-master", "talker", "listener"}
    assert found["talker"]["spec"]["nodeName"] != found["listener"]["spec"]["nodeName"]


def test_messages_arrive(demo: Demo) -> None:
    """The listener's log shows what the talker says."""
    lines = demo("logs", "listener", "--tail", "5").stdout.splitlines()
    assert len(lines) == 5
    assert all("I heard hello world" in line for line in lines)


def assert_a_new_message_arrives(demo: Demo) -> None:
    """Set a parameter that the talker puts into its messages, and find it in the listener's log."""
    nonce = secrets.token_hex(8)
    demo("exec", "talker", "--", "rosparam", "set", "/nonce", f"n{nonce}")
    until(lambda: nonce in demo("logs", "listener", "--tail", "20").stdout, nonce)


def test_a_message_made_now_arrives(demo: Demo) -> None:
    assert_a_new_message_arrives(demo)


def test_ros_tools_work_in_a_node(demo: Demo) -> None:
    """`rigel exec` has ROS set up, and passes the exit code on."""
    assert "/chatter" in demo("exec", "talker", "--", "rostopic", "list").stdout.splitlines()
    assert demo("exec", "talker", "--", "sh", "-c", "exit 7", check=False).returncode == 7


def test_status_tells_all_ready(demo: Demo) -> None:
    """As a table for people, as JSON for scripts."""
    assert re.search(r"talker\s+1/1", demo("status").stdout)
    found = json.loads(demo("status", "-o", "json").stdout)
    assert {w["name"]: w["ready"] for w in found["workloads"]} == {
        "ros-master": 1,
        "talker": 1,
        "listener": 1,
    }


def test_nothing_changes_when_nothing_changed(demo: Demo, cluster: Any, space: str) -> None:
    """A second deploy writes nothing: the same pods, the same revisions, an empty diff."""
    before = {name: pod["metadata"]["uid"] for name, pod in pods(cluster, space).items()}
    revisions = json.loads(demo("history", "-o", "json").stdout)
    assert demo("diff", "deploy", "--exit-code", check=False).returncode == 0
    demo("run", "job", "deploy")
    assert json.loads(demo("history", "-o", "json").stdout) == revisions
    after = {name: pod["metadata"]["uid"] for name, pod in pods(cluster, space).items()}
    assert before == after


def test_the_update_rolls_out_the_same_tag_and_only_the_talker(
    demo: Demo, cluster: Any, space: str
) -> None:
    """A new content under the same tag is another digest: only the talker's pod is replaced."""
    before = pods(cluster, space)
    demo("run", "sequence", "update")
    after = pods(cluster, space)
    image = {n: p["spec"]["containers"][0]["image"] for n, p in after.items()}
    assert "@sha256:" in image["talker"]
    assert image["talker"] != before["talker"]["spec"]["containers"][0]["image"]
    for name in ("ros-master", "listener"):
        assert after[name]["metadata"]["uid"] == before[name]["metadata"]["uid"]
    assert "VERSION=2" in demo("exec", "talker", "--", "env").stdout.splitlines()


def test_the_old_talker_was_heard_until_the_new_one_had_begun(demo: Demo) -> None:
    """The demo prints the longest time without a message."""
    heard = demo("logs", "listener", "--timestamps").stdout
    assert_took_over(heard, demo("logs", "talker", "--timestamps").stdout)
    assert "s; the longest time without one: " in longest_gap(EXAMPLE.parent, heard)


def test_rollback_brings_the_first_version_back(demo: Demo) -> None:
    """One command undoes the update, and messages flow again."""
    demo("rollback")
    assert "VERSION=1" in demo("exec", "talker", "--", "env").stdout.splitlines()
    assert_a_new_message_arrives(demo)


def test_down_leaves_nothing(demo: Demo, cluster: Any, space: str) -> None:
    """No workload, Service, ConfigMap, revision or Lease of the release stays."""
    demo("down")
    kinds = [("apps/v1", "Deployment"), ("v1", "Service"), ("v1", "Secret")]
    kinds += [("coordination.k8s.io/v1", "Lease")]
    left = [o["metadata"]["name"] for api, kind in kinds for o in cluster.list(api, kind, space)]
    assert left == []
    maps = [o["metadata"]["name"] for o in cluster.list("v1", "ConfigMap", space)]
    assert maps == ["kube-root-ca.crt"]

"""`rigel logs --since --level` with a real Loki, and without one."""

from __future__ import annotations

import json
import re
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.objects.refs import ObjectRef

from ...background import Background
from .conftest import App, until

pytestmark = pytest.mark.cluster

#: rclpy, with its real logging; it says each level once.
ROS2 = """
import rclpy, time
rclpy.init()
node = rclpy.create_node("shouter2")
node.get_logger().set_level(10)
print("plain", flush=True)
node.get_logger().debug("this is debug")
node.get_logger().info("this is info")
node.get_logger().warn("this is warn")
node.get_logger().error("this is error")
node.get_logger().fatal("this is fatal")
time.sleep(1000)
"""


def numbers(lines: list[dict[str, Any]]) -> dict[str, list[int]]:
    """Return the talker's numbers, by pod, in the order in which they were told."""
    found: dict[str, list[int]] = {}
    for line in lines:
        if said := re.search(r": said (\d+)$", line["text"]):
            found.setdefault(line["pod"], []).append(int(said[1]))
    return found


def test_lines_of_a_pod_that_is_gone_are_found(app: App, cluster: Any) -> None:
    """With their levels and tracebacks; nothing is missing or there twice."""
    [old] = until(lambda: {x["pod"] for x in app.lines("--since", "1h", "talker")}, "its lines")

    def has_failed() -> bool:
        return any(line["pod"] == old for line in app.lines("--level", "error", "talker"))

    until(has_failed, "an error of the talker")
    cluster.delete(ObjectRef("v1", "Pod", app.namespace, old))
    until(lambda: cluster.get(ObjectRef("v1", "Pod", app.namespace, old)) is None, "the pod's end")
    until(lambda: len(numbers(app.lines("--since", "1h", "talker"))) > 1, "the next pod's lines")

    errors = [
        x for x in app.lines("--since", "1h", "--level", "error", "talker") if x["pod"] == old
    ]
    assert {line["level"] for line in errors} == {"error"}
    assert any("failed 20" in line["text"] for line in errors)
    assert any("IndexError" in line["text"] for line in errors), "its traceback"
    assert not any("late" in line["text"] for line in errors)
    assert errors[0]["ros_name"] == "/talker"
    assert errors[0]["node"]
    everything = app.lines("--since", "1h", "talker")
    for said in numbers(everything).values():
        assert said == list(range(1, len(said) + 1))
    assert "failed 20" in app("logs", "--level", "error", old).stdout, "by the pod's name too"


def test_lines_of_all_nodes_are_in_the_order_of_time(app: App) -> None:
    """What was heard stands after what was said; the exporter is no ROS node."""
    lines = app.lines("--since", "1h")  # some say something at their start alone
    assert [line["time"] for line in lines] == sorted(line["time"] for line in lines)
    assert {line["workload"] for line in lines} == {
        "talker",
        "lab-listener",
        "shouter",
        "ros-master",
    }


def levels(lines: list[dict[str, Any]]) -> dict[str, str | None]:
    """Return the level of each line that a shouter has said."""
    said = ((re.search(r"(this is \w+|plain)$", x["text"]), x["level"]) for x in lines)
    return {found[1]: level for found, level in said if found}


EACH = {
    "plain": None,
    "this is debug": "debug",
    "this is info": "info",
    "this is warn": "warn",
    "this is error": "error",
    "this is fatal": "fatal",
}


def test_levels_of_ros_1(app: App, limited: Callable[..., App]) -> None:
    """The same from Loki, where the collector has read them, and from the API server."""
    wanted = {name.replace("is error", "is err"): level for name, level in EACH.items()}
    until(lambda: len(levels(app.lines("--since", "1h", "shouter"))) == len(EACH), "its lines")
    assert levels(app.lines("--since", "1h", "shouter")) == wanted
    assert levels(limited().lines("--since", "1h", "shouter")) == wanted
    above = levels(app.lines("--level", "warn", "shouter"))
    assert above == {"this is warn": "warn", "this is err": "error", "this is fatal": "fatal"}


def test_more_lines_than_loki_gives_at_once(app: App) -> None:
    """All of them, once and in order; and the last ones without reading the others."""

    def flood(*words: str) -> list[int]:
        texts = [line["text"] for line in app.lines("--since", "1h", *words, "shouter")]
        return [int(text.split()[1]) for text in texts if text.startswith("flood ")]

    found = until(lambda: (lines := flood())[-1:] == [11999] and lines, "the last line")
    assert found == list(range(12000))
    last = flood("--tail", "50")
    assert last == list(range(12000 - len(last), 12000))
    assert 30 < len(last) <= 50


@pytest.fixture
def ros2_app(app: App, cluster: Any, ros2_image: str, tmp_path: Path) -> Iterator[App]:
    """A node of ROS 2, in a release of its own."""
    name = f"t-reading-{uuid.uuid4().hex[:6]}"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    nodes = {"shouter2": {"image": ros2_image, "args": ["python3", "-c", ROS2]}}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": {"nodes": nodes}}
    text = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
    made = App(tmp_path / "Rigelfile", app.context, name)
    made.file.write_text(json.dumps(text))
    made("run", "job", "deploy", "--timeout", "8m")
    yield made
    cluster.delete(ObjectRef("v1", "Namespace", "", name))


def test_levels_of_ros_2(ros2_app: App) -> None:
    """The same from Loki and from the API server."""

    def now() -> dict[str, str | None]:
        return levels([json.loads(x) for x in ros2_app("logs", "-o", "json").stdout.splitlines()])

    until(lambda: len(now()) == len(EACH), "its lines")  # it is ready before it says them
    assert now() == EACH
    until(lambda: len(levels(ros2_app.lines("--since", "1h"))) == len(EACH), "its lines")
    assert levels(ros2_app.lines("--since", "1h")) == EACH
    above = {"this is error": "error", "this is fatal": "fatal"}
    assert levels(ros2_app.lines("--level", "error")) == above


def test_without_loki_the_lines_are_the_same(app: App, limited: Callable[..., App]) -> None:
    """Of existing containers; a stack that may not be asked is named."""
    someone = limited()
    told = someone("logs", "--since", "1h", "--level", "warn", "talker")
    assert all("only the lines of existing containers" in one for one in told.stderr.splitlines())

    def existing() -> list[dict[str, Any]] | None:
        """Its lines, once there is one of each level: its pod may be new."""
        done = someone("logs", "--level", "warn", "-o", "json", "talker")
        found = [json.loads(line) for line in done.stdout.splitlines()]
        return found if any(line["level"] == "error" for line in found) else None

    lines = until(existing, "an error of the talker")
    assert {line["level"] for line in lines} == {"warn", "error"}
    pod, last = lines[0]["pod"], lines[-1]["time"]
    first = lines[0]["time"]
    wanted = Counter(line["text"] for line in lines)

    def stored() -> Counter[str]:
        """What Loki has of them: a line arrives there a moment after it was said."""
        return Counter(
            line["text"]
            for line in app.lines("--level", "warn", "talker")
            if line["pod"] == pod and first <= line["time"] <= last
        )

    until(lambda: stored().total() >= wanted.total(), "the last line in Loki")
    assert stored() == wanted


def test_a_loki_that_was_there_before_is_asked(
    app: App, stack: str, limited: Callable[..., App], tmp_path: Path
) -> None:
    """Where the job names it, nothing is looked for; the right to ask it is enough."""
    right = {"apiGroups": [""], "resources": ["services/proxy"], "verbs": ["get"]}
    text = json.loads(app.file.read_text())
    options = text["jobs"]["deploy"]["with"]["observability"]
    options["existing"] = {"loki": {"url": f"http://loki.{stack}.svc:3100"}}
    there = attrs.evolve(limited([right]), file=tmp_path / "Rigelfile")
    there.file.write_text(json.dumps(text))
    words = ("logs", "--since", "1h", "--level", "error", "talker")
    until(lambda: "failed 20" in there(*words).stdout, "an error of the talker")
    assert there(*words).stderr == ""


def test_plain_logs_ask_for_no_stack(app: App, limited: Callable[..., App]) -> None:
    """Who may read nothing but pods gets the same, without a word."""
    told = limited()("logs", "--tail", "3", "talker")
    assert told.stderr == ""
    assert len(told.stdout.splitlines()) == 3
    assert re.match(r"20\d\d-\d\d-\d\dT\S+Z ", app("logs", "--timestamps", "talker").stdout)


def test_the_last_lines_of_a_level(app: App) -> None:
    """--tail counts what is left by --level, of each pod."""
    lines = app(
        "logs", "--since", "1h", "--level", "warn", "--tail", "2", "--timestamps", "shouter"
    )
    texts = lines.stdout.splitlines()
    assert len(texts) == 2
    assert all(re.match(r"20\d\d-\d\d-\d\dT\S+Z \[(ERROR|FATAL)\]", text) for text in texts)


def test_follow_goes_on_where_the_past_ends(
    app: App, cluster: Any, start: Callable[..., Background]
) -> None:
    """Past lines of the container and what comes: nothing is missing or there twice, also in the
    next pod."""
    running = start(app.command("logs", "-f", "--since", "1m", "-o", "json", "talker"))

    def lines() -> list[dict[str, Any]]:
        return [json.loads(line) for line in list(running.lines) if line.startswith("{")]

    until(lambda: running.lines, "the first line")
    before = len(running.lines)
    until(lambda: len(running.lines) > before + 20, "lines as they come")
    pods = cluster.list("v1", "Pod", app.namespace, labels={"app.kubernetes.io/name": "talker"})
    for pod in pods:
        cluster.delete(ObjectRef("v1", "Pod", app.namespace, pod["metadata"]["name"]))
    seen = set(numbers(lines()))
    until(lambda: set(numbers(lines())) - seen, "lines of the next pod")
    assert running.interrupt() == 130
    found = lines()
    for said in numbers(found).values():
        assert said == list(range(said[0], said[0] + len(said)))
    failed = sum("failed" in line["text"] for line in found)
    assert sum(line["text"] == "IndexError: list index out of range" for line in found) == failed


def test_a_name_that_means_nothing_is_told(app: App) -> None:
    """With the names that there are, as without Loki."""
    assert 'did you mean "talker"?' in app("logs", "--since", "1h", "taker", code=2).stderr

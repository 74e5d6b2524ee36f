"""Habits of command lines and of docker compose that a pod does not have."""

from __future__ import annotations

import pytest

from .shapes import problems

READY = "args: x, readiness: {command: %s}"
#: The generation, a node, the severity and kind of the one problem, and what its message contains.
CASES = [
    ("2", READY % '[bash, -c, "ros2 node list | grep n"]', "warning", "probe", "exec.sh"),
    ("1", READY % "rosnode ping -c1 n", "warning", "probe", "does not find rosnode"),
    ("2", READY % "[bash, -c, '. /opt/ros/jazzy/setup.sh; ros2 node list']", "", "", ""),
    ("1", READY % "[/bin/sh, /rigel-k8s/exec.sh, rosservice, info, a]", "", "", ""),
    ("2", READY % "curl localhost:80", "", "", ""),
    ("2", "args: ros2 bag play /bag, anonymous: true", "warning", "ends", "starts it again"),
    ("2", "args: ros2 bag play /bag --loop, anonymous: true", "", "", ""),
    ("1", "args: rosbag play /a.bag", "warning", "ends", "kind: task"),
    ("2", "args: ros2 topic pub --once /a std_msgs/String, anonymous: true", "warning", "ends", ""),
    ("2", "args: ros2 topic pub /a std_msgs/String, anonymous: true", "", "", ""),
    ("2", "args: ros2 service call /a std_srvs/Empty, anonymous: true", "warning", "ends", ""),
    ("2", "args: sleep infinity", "warning", "ends", "set `ros: none`"),
    ("2", "args: [tail, -f, /dev/null]", "warning", "ends", "never becomes ready"),
    ("2", "args: bash", "warning", "ends", "never becomes ready"),
    ("2", "args: sleep infinity, ros: none", "", "", ""),
    ("2", "args: ros2 bag play /bag, kind: test", "", "", ""),
    ("2", "args: ros2 bag play /bag, kind: task", "", "", ""),
    ("2", "package: controller_manager, executable: spawner", "warning", "ends", "kind: task"),
    ("1", "package: controller_manager, executable: spawner", "", "", ""),
    ("2", "package: controller_manager, executable: spawner, kind: task", "", "", ""),
    ("2", "args: [bash, -c, talker]", "", "", ""),
    ("2", 'args: ["ros2 run p e"]', "warning", "one-word", '"ros2 run p e" is one word'),
    ("2", "args: ros2 run p e", "", "", ""),
    (
        "2",
        "args: [--flag], components: {c: {package: a, plugin: 'a::B'}}",
        "error",
        "bad-command",
        '"--flag" would be the program',
    ),
    ("2", "components: {c: {package: a, plugin: a/B}}", "error", "bad-plugin", "a::B"),
    ("1", "components: {c: {plugin: a/B}}", "", "", ""),
]


@pytest.mark.parametrize(("ros", "node", "severity", "kind", "words"), CASES)
def test_a_habit_has_a_word(ros: str, node: str, severity: str, kind: str, words: str) -> None:
    text = f"{{image: a, ros: '{ros}', nodes: {{n: {{{node}}}}}}}"
    kinds = {"probe", "ends", "one-word", "bad-command", "bad-plugin"}
    found = [p for p in problems(text) if p.kind in kinds]
    assert [(p.severity, p.kind) for p in found] == ([(severity, kind)] if kind else [])
    assert all(words in p.message for p in found)


@pytest.mark.parametrize(
    "name", ["device-0", "volume-1", "rigel-logs", "rigel-inpod", "n0-volume-1"]
)
def test_a_volume_is_not_called_as_ours(name: str) -> None:
    """One of the two would replace the other, or Kubernetes refuse both."""
    text = f"{{persistent_storage: {{volumes: [{{name: {name}}}, {{name: bags}}]}}}}"
    places = [p.path for p in problems(text) if p.kind == "name-taken"]
    assert places == [("persistent_storage", "volumes", 0, "name")]


@pytest.mark.parametrize(
    ("server", "path", "wrong"),
    [
        *(("loki", path, True) for path in ("loki/api/v1/push", "loki/api/v1", "otlp/v1/logs")),
        *(("prometheus", path, True) for path in ("api/v1/query", "graph", "metrics")),
        *((server, path, False) for server in ("loki", "prometheus") for path in ("", "below/it")),
    ],
)
def test_the_address_of_a_server_is_its_own(
    server: str,
    path: str,
    wrong: bool,  # noqa: FBT001 - a parameter
) -> None:
    """The path of a request, which people paste, would be there twice."""
    existing = f"{{{server}: {{url: 'http://{server}:90/{path}'}}}}"
    text = f"{{observability: {{enabled: true, existing: {existing}}}}}"
    found = [p for p in problems(text) if p.kind == "bad-url"]
    assert [p.path for p in found] == [("observability", "existing", server, "url")] * wrong
    assert all(p.message.endswith(f"write http://{server}:90") for p in found)


@pytest.mark.parametrize(
    ("network", "messages"),
    [
        ("{peers: [x]}", ["only `mode: peers` reads `peers`: add it"]),
        ("{servers: 2}", ["only `mode: discovery-server` reads `servers`: add it"]),
        ("{mode: peers, peers: [x]}", []),
    ],
)
def test_a_forgotten_mode_is_named(network: str, messages: list[str]) -> None:
    text = f"{{image: a, ros: '2', network: {network}, nodes: {{n: {{args: x}}}}}}"
    assert [p.message for p in problems(text) if p.severity == "error"] == messages

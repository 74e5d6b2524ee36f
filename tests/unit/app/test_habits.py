"""Habits of command lines and of docker compose that a pod does not have."""

from __future__ import annotations

import json
import re

import pytest

from rigel_k8s.app.foreign import OF_JOBS, OF_NODES
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.rigelfile.fields import fields_by_key
from tests.support.ros_names import ARGUMENTS

from .shapes import problems

READY = "args: x, readiness: {command: %s}"
HOOK = "args: x, patch: {spec: {template: {spec: {containers: [{name: ros-node, %s}]}}}}"
ROS_ARGS = "package: p, executable: e, args: [--ros-args, %s]"
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
    ("2", READY % "[python3, -c, import rclpy]", "warning", "probe", "does not find rclpy"),
    ("2", READY % "test -f /a && true", "warning", "no-shell", '"&&" is a plain word'),
    ("2", READY % "[sh, -c, 'test -f /a && true']", "", "", ""),
    ("1", "args: x, parameter_commands: {a: xacro b > c}", "warning", "no-shell", '">" is a plain'),
    ("2", READY % "[CMD, curl, localhost]", "error", "bad-command", "docker compose only"),
    ("2", HOOK % "livenessProbe: {exec: {command: [ros2, node, list]}}", "warning", "probe", ""),
    ("2", HOOK % "lifecycle: {preStop: {exec: {command: [ros2, doctor]}}}", "warning", "probe", ""),
    ("2", HOOK % "livenessProbe: {exec: {command: [cat, /a]}}", "", "", ""),
    ("2", "command: ros2 run p e", "warning", "probe", "write `args` instead"),
    ("1", "command: [bash, -c, 'cd /ws && roslaunch p f']", "warning", "probe", "roslaunch"),
    ("1", "command: [bash, -c, '. devel/setup.bash && rosrun p e']", "", "", ""),
    ("2", "command: [/entrypoint.sh, ros2, run, p, e]", "", "", ""),
    ("2", "command: ros2 run p e, ros: none", "", "", ""),
    *(
        (ros, f"args: [bash, -c, '{line}']", "warning", "ends", words)
        for ros, line, words in (
            ("2", "source /ws/setup.bash && ros2 bag play /b", "ros2 bag play ends"),
            ("2", "A=b exec ros2 bag play /b", "ros2 bag play ends"),
            ("2", "ros2 run controller_manager spawner a", "spawner ends"),
            ("2", "sleep infinity", "set `ros: none`"),
            ("1", ". /ws/setup.sh; rosbag play /b", "rosbag play ends"),
        )
    ),
    *(
        ("2", f"args: [bash, -c, '{line}']", "", "", "")
        for line in (
            "ros2 bag play /b --loop",
            "while true; do ros2 bag play /b; done",
            "ros2 launch p f & sleep infinity",
            "ros2 bag play /b; exec ros2 run p e",
            "ros2 run p e 2>&1 | tee /log",
        )
    ),
    *(
        (ros, f"args: {line}, anonymous: true", "warning", "ends", "starts it again")
        for ros, line in (
            ("2", "env A=b ros2 bag play /b"),
            ("2", "ros2 action send_goal /a b c"),
            ("2", "ros2 lifecycle set /n configure"),
            ("2", "ros2 control load_controller a"),
            ("2", "ros2 param load /n f"),
            ("2", "ros2 run nav2_map_server map_saver_cli"),
            ("1", "rosparam load /a.yaml"),
            ("1", "rosnode cleanup"),
            ("1", "rosrun map_server map_saver"),
        )
    ),
    *((ros, f"args: {line}", "", "", "") for ros, line in (("2", "ros2 topic hz /a"),)),
    ("1", "package: rosbag, executable: play, args: /b", "warning", "ends", "rosbag play ends"),
    ("1", "package: rosbag, executable: play, args: /b --loop", "", "", ""),
    ("2", "args: fastdds discovery -i 0", "warning", "ends", "`network: discovery-server`"),
    ("2", "package: rmw_zenoh_cpp, executable: rmw_zenohd", "warning", "ends", "`network: zenoh`"),
    ("2", "args: fastdds discovery -i 0, ros: none", "", "", ""),
    ("2", 'args: ["bash -c", talker]', "warning", "one-word", '"bash -c" is one word'),
    ("2", "package: p, executable: talker --flag", "warning", "one-word", "talker --flag"),
    ("2", "package: p e, executable: talker", "warning", "one-word", '"p e" is one word'),
    ("2", "launch: {file: 'a.launch.py b:=c'}", "warning", "one-word", "a.launch.py b:=c"),
    ("1", "launch: {file: $(find p)/a.launch}, substitution_args: true", "", "", ""),
    ("2", "package: p, executable: a.launch.py", "error", "bad-command", "launch: {file"),
    ("2", "package: p, executable: e, args: ['--rate 10']", "warning", "one-word", "--rate 10"),
    ("2", "package: p, executable: e, args: ['--name=a b', -x]", "", "", ""),
    ("2", "args: [python3, -c, 'a b', x y]", "", "", ""),
    ("2", ROS_ARGS % "'-p a:=1'", "error", "one-word", '"-p a:=1" is one word'),
    ("2", "args: [e, '--rate 10', --ros-args, -p, 'a:=1']", "warning", "one-word", "--rate 10"),
    ("2", "args: bash -c ros2 run p e", "warning", "one-word", 'runs "ros2" without'),
    ("2", 'args: [bash, -ec, run "$@", --, a]', "", "", ""),
    ("2", "args: [bash, run.sh, -c, a, b]", "", "", ""),
    ("2", "args: ROS_DOMAIN_ID=4 talker", "warning", "no-shell", '"ROS_DOMAIN_ID=4" is a plain'),
    ("2", "args: talker $ROBOT", "warning", "no-shell", '"$ROBOT" is a plain word'),
    ("2", "args: talker $(ROBOT) ^/a$", "", "", ""),
    ("2", "args: [bash, -c, 'A=b talker $ROBOT']", "", "", ""),
    ("2", "args: x, env: {A: '${A:-b}'}", "warning", "no-substitution", "{{ vars.NAME }}"),
    ("2", "args: x, env: {A: 'a$b', B: $(A)}", "", "", ""),
    ("1", "args: x, env: {ROSCONSOLE_FORMAT: '[${node}]: ${message}'}", "", "", ""),
    *(
        ("2", ROS_ARGS % words, "error", "ros-args", message)
        for words, message in (
            ("-r, '~a:=/b'", "a private name is written ~/NAME"),
            ("-r, 'a:=/b-c'", '"/b-c" is not'),
            ("-r, a", '"a" behind -r is not NAME:=VALUE'),
            ("-p, a=1", '"a=1" behind -p'),
            ("-p, 'a:='", '"a:=" behind -p'),
            ("'a:=1'", "write -p or -r before it"),
            ("--verbose, x", 'does not know "--verbose"'),
            ("-p, 'a:=1', -r", "-r has no value"),
        )
    ),
    *(
        ("2", ROS_ARGS % words, "", "", "")
        for words in (
            "--params-file, /a.yaml, --, --verbose, x",
            "-r, 'a:=$(NAME)', -p, 'b:={{ data.b }}'",
        )
    ),
    ("2", "package: p, executable: e, args: '_rate:=5'", "warning", "ros-args", "form of ROS 1"),
    ("2", "args: 'talker ~in:=/x'", "warning", "ros-args", "or -r ~/NAME"),
    ("2", "args: 'talker chatter:=/x ~/in:=/y'", "", "", ""),
    ("2", "args: 'ros2 run xacro xacro a.xacro b:=c'", "", "", ""),
    ("2", "launch: {file: a.launch.py, args: {b: c}}", "", "", ""),
    ("1", "package: p, executable: e, args: '_rate:=5'", "", "", ""),
    ("2", "components: {c: {package: a, plugin: a/B}}", "error", "bad-plugin", "a::B"),
    ("1", "components: {c: {plugin: a/B}}", "", "", ""),
]


@pytest.mark.parametrize(("ros", "node", "severity", "kind", "words"), CASES)
def test_a_habit_has_a_word(ros: str, node: str, severity: str, kind: str, words: str) -> None:
    text = f"{{image: a, ros: '{ros}', nodes: {{n: {{{node}}}}}}}"
    kinds = {"probe", "ends", "one-word", "bad-command", "bad-plugin", "ros-args", "no-shell"}
    kinds.add("no-substitution")
    found = [p for p in problems(text) if p.kind in kinds]
    assert [(p.severity, p.kind) for p in found] == ([(severity, kind)] if kind else [])
    assert all(words in p.message for p in found)


@pytest.mark.parametrize(("words", "starts"), ARGUMENTS)
def test_arguments_of_ros2_are_those_that_rcl_reads(
    words: list[str],
    starts: bool,  # noqa: FBT001 - a parameter
) -> None:
    listed = json.dumps(["e", "--ros-args", *words])
    found = problems(f"{{image: a, ros: '2', nodes: {{n: {{args: {listed}}}}}}}")
    assert any(p.severity == "error" for p in found) is not starts


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
        (
            "{domain_id: 7}",
            [
                "macvlan, the mode by default, needs `interface` and `subnet`: add them, or"
                " another `mode`"
            ],
        ),
    ],
)
def test_a_forgotten_mode_is_named(network: str, messages: list[str]) -> None:
    text = f"{{image: a, ros: '2', network: {network}, nodes: {{n: {{args: x}}}}}}"
    assert [p.message for p in problems(text) if p.severity == "error"] == messages


@pytest.mark.parametrize("key", [*OF_NODES, *OF_JOBS])
def test_a_key_of_another_file_is_none_of_ours(key: str) -> None:
    """Else it would never be read; each leads to an option that exists, or to no key at all."""
    for kind, foreign in ((NodeOptions, OF_NODES), (OrchestrationOptions, OF_JOBS)):
        if key in foreign:
            assert key not in fields_by_key(kind)
            named = re.findall(r"`([a-z_]+)", foreign[key])
            known = {*fields_by_key(NodeOptions), *fields_by_key(OrchestrationOptions), "distro"}
            assert set(named) <= {*known, "application"}

"""What a user gives and what `rigel` sets: an error where nothing could work, else a warning."""

from __future__ import annotations

import pytest

from rigel_k8s.app.checks.contradictions import KIND, RULES

from .shapes import GOLDEN, problems

PEERS, SERVER = "network: peers", "network: discovery-server"
FOUR = "network: {mode: peers, domain_id: 4}"
HOST, ZENOH, NONE = "network: host", "network: zenoh", "network: none"
LAN = "network: {mode: macvlan, interface: eth0, subnet: 10.20.0.0/24}"
PATCH = "{spec: {template: {spec: {containers: [{name: ros-node, env: [%s]}]}}}}"
APP = "rigel-k8s-application"
FROM = "{configMapKeyRef: {name: a, key: b}}"

#: The job, the node's options, the severity (- for none), and what the message contains.
ROS2 = [
    (PEERS, "env: {ROS_DOMAIN_ID: 42}", "error", "network: {mode: peers, domain_id: 42}"),
    (PEERS, 'env: {ROS_DOMAIN_ID: "42"}', "error", "domain_id: 42"),
    (PEERS, "env: [{name: ROS_DOMAIN_ID, value: 42}]", "error", "domain_id: 42"),
    (PEERS, f"env: [{{name: ROS_DOMAIN_ID, valueFrom: {FROM}}}]", "error", "domain of its own"),
    (PEERS, "env: {ROS_DOMAIN_ID: $(ROBOT)}", "error", "domain of its own"),
    (PEERS, 'env: {ROS_DOMAIN_ID: ""}', "error", "domain_id: 0"),
    (PEERS, "env: {ROS_DOMAIN_ID: '{{ data.domain }}'}", "error", 'domain_id: "{{ data.domain }}"'),
    (PEERS, f"patch: {PATCH % '{name: ROS_DOMAIN_ID, value: 7}'}", "error", "domain_id: 7"),
    (FOUR, "env: {ROS_DOMAIN_ID: 42}", "error", "the release's domain, 4,"),
    (FOUR, "env: {ROS_DOMAIN_ID: 4}", "-", ""),
    (FOUR, "env: {ROS_DOMAIN_ID: '{{ data.domain }}'}", "-", ""),
    (FOUR, f"env: [{{name: ROS_DOMAIN_ID, valueFrom: {FROM}}}]", "warning", "no one knows"),
    (SERVER, "env: {ROS_DOMAIN_ID: 42}", "error", "mode: discovery-server, domain_id: 42"),
    *(
        (network, f"env: {{ROS_DOMAIN_ID: '{wrong}'}}", "error", "not a DDS domain")
        for network in (PEERS, HOST, NONE)
        for wrong in ("300", "-1", "abc", "0x2a", "010", "4.2", "true", " 42")
    ),
    (HOST, "env: {ROS_DOMAIN_ID: 42}", "warning", "do not find it"),
    (HOST, "env: {ROS_DOMAIN_ID: 0}", "-", ""),
    (ZENOH, "env: {ROS_DOMAIN_ID: 42}", "warning", "do not find it"),
    (NONE, "env: {ROS_DOMAIN_ID: 42}", "-", ""),
    (PEERS, "ros: none, env: {ROS_DOMAIN_ID: 42}", "-", ""),
    (PEERS, "env: {ROS_DOMAIN: 42}", "-", ""),
    (PEERS, "args: [bash, -c, ROS_DOMAIN_ID=42 exec talker]", "error", "domain_id: 42"),
    (PEERS, "args: [bash, -c, \"export ROS_DOMAIN_ID='42'; talker\"]", "error", "domain_id: 42"),
    (PEERS, "args: [env, ROS_DOMAIN_ID=42, ros2, run, p, e]", "error", "domain_id: 42"),
    (PEERS, "command: [/ros_entrypoint.sh, env, ROS_DOMAIN_ID=42, talker]", "error", "domain_id"),
    (PEERS, "args: [bash, -c, MY_ROS_DOMAIN_ID=42 talker]", "-", ""),
    ("middleware: fastdds", "env: {RMW_IMPLEMENTATION: rmw_fastrtps_cpp}", "-", ""),
    ("middleware: fastdds", "env: {RMW_IMPLEMENTATION: rmw_fastrtps_dynamic_cpp}", "-", ""),
    (
        f"{PEERS}, middleware: fastdds",
        "env: {RMW_IMPLEMENTATION: rmw_cyclonedds_cpp}",
        "error",
        "or set `middleware: cyclonedds`",
    ),
    (
        f"{NONE}, middleware: fastdds",
        "env: {RMW_IMPLEMENTATION: rmw_cyclonedds_cpp}",
        "warning",
        "configures fastdds only",
    ),
    (SERVER, "env: {RMW_IMPLEMENTATION: rmw_cyclonedds_cpp}", "error", "fastdds only: remove it"),
    (ZENOH, "env: {RMW_IMPLEMENTATION: rmw_fastrtps_cpp}", "error", "zenoh only"),
    (PEERS, "env: {RMW_IMPLEMENTATION: rmw_cyclonedds_cpp}", "-", ""),
    (PEERS, "env: {RMW_IMPLEMENTATION: rmw_zenoh_cpp}", "error", "needs a router"),
    (PEERS, "env: {RMW_IMPLEMENTATION: rmw_zenoh_cpp, ZENOH_CONFIG_OVERRIDE: x}", "-", ""),
    (PEERS, "env: {RMW_IMPLEMENTATION: cyclonedds}", "error", "write rmw_cyclonedds_cpp"),
    (PEERS, "env: {ROS_LOCALHOST_ONLY: 1}", "error", "no node of another pod"),
    (PEERS, "env: {ROS_LOCALHOST_ONLY: 0}", "-", ""),
    (HOST, "env: {ROS_LOCALHOST_ONLY: 1}", "warning", "of its own machine"),
    (NONE, "env: {ROS_LOCALHOST_ONLY: 1}", "warning", "no node of another pod"),
    (LAN, "env: {ROS_AUTOMATIC_DISCOVERY_RANGE: 'OFF'}", "error", "OFF ends discovery"),
    (LAN, "env: {ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST}", "error", "LOCALHOST ends"),
    (LAN, "env: {ROS_AUTOMATIC_DISCOVERY_RANGE: subnet}", "error", '"subnet" for LOCALHOST'),
    (LAN, "env: {ROS_AUTOMATIC_DISCOVERY_RANGE: SUBNET}", "-", ""),
    (LAN, "env: {ROS_AUTOMATIC_DISCOVERY_RANGE: SYSTEM_DEFAULT}", "-", ""),
    (PEERS, "env: {ROS_AUTOMATIC_DISCOVERY_RANGE: SYSTEM_DEFAULT}", "warning", "leave out"),
    (SERVER, "env: {ROS_DISCOVERY_SERVER: robot:11811}", "error", "asks other servers"),
    (
        SERVER,
        f"env: {{ROS_DISCOVERY_SERVER: 'other:1;{APP}-discovery-0:11811'}}",
        "-",
        "",
    ),
    (HOST, "env: {ROS_DISCOVERY_SERVER: robot:11811}", "warning", "only its other clients"),
    (PEERS, "env: {ROS_STATIC_PEERS: 10.0.0.5}", "warning", "replaces the list"),
    (PEERS, "env: {FASTDDS_BUILTIN_TRANSPORTS: SHM}", "error", "no memory in common"),
    (PEERS, "env: {FASTDDS_BUILTIN_TRANSPORTS: UDPv4}", "-", ""),
    (HOST, "env: {FASTDDS_BUILTIN_TRANSPORTS: DEFAULT}", "warning", "no other pod reads"),
    (LAN, "env: {FASTDDS_BUILTIN_TRANSPORTS: DEFAULT}", "-", ""),
    (ZENOH, "env: {ZENOH_CONFIG_OVERRIDE: a/b=true}", "error", "begin it with mode="),
    (
        ZENOH,
        f"env: {{ZENOH_CONFIG_OVERRIDE: 'connect/endpoints=[\"tcp/{APP}-zenoh:7447\"]'}}",
        "-",
        "",
    ),
    (PEERS, "args: [tini, --, bash, -c, ROS_DOMAIN_ID=42 talker]", "error", "domain_id: 42"),
    *(
        (PEERS, f"env: {{RMW_IMPLEMENTATION: {wrong}}}", "error", f"write {right}")
        for wrong, right in (
            ("rmw_cyclonedds", "rmw_cyclonedds_cpp"),
            ("rmw_fastdds_cpp", "rmw_fastrtps_cpp"),
            ("rmw_zenoh", "rmw_zenoh_cpp"),
        )
    ),
    (PEERS, "env: {RMW_IMPLEMENTATION: rmw_connextdds}", "-", ""),
    (PEERS, "env: {FASTDDS_BUILTIN_TRANSPORTS: UDPv6}", "error", "look for each other by IPv4"),
    (NONE, "env: {FASTDDS_BUILTIN_TRANSPORTS: UDPv6}", "-", ""),
    (PEERS, "env: {CYCLONEDDS_URI: file:///c.xml}", "warning", "replaces file:///rigel-k8s"),
    (LAN, "env: {CYCLONEDDS_URI: <CycloneDDS/>}", "warning", "cyclonedds.xml, by which"),
    (f"{PEERS}, middleware: fastdds", "env: {CYCLONEDDS_URI: file:///c.xml}", "-", ""),
    (HOST, "env: {CYCLONEDDS_URI: file:///c.xml}", "-", ""),
    (
        PEERS,
        "env: {CYCLONEDDS_URI: 'file:///rigel-k8s-network/cyclonedds.xml,file:///c.xml'}",
        "-",
        "",
    ),
    (LAN, "env: {FASTRTPS_DEFAULT_PROFILES_FILE: /f.xml}", "warning", "fastdds.xml"),
    (PEERS, "env: {FASTRTPS_DEFAULT_PROFILES_FILE: /f.xml}", "-", ""),
    (LAN, "env: {FASTDDS_DEFAULT_PROFILES_FILE: /f.xml}", "-", ""),
    (LAN, "ros: none, env: {FASTDDS_DEFAULT_PROFILES_FILE: /f.xml}", "warning", "fastdds.xml"),
    (PEERS, 'args: [--ros-args, -r, "__node:=cam"]', "error", "`name: cam`"),
    (PEERS, 'args: [--ros-args, --remap, "__name:=cam"]', "error", "`name: cam`"),
    (PEERS, 'args: [--ros-args, -r, "__ns:=/r1"]', "error", "`name: n, namespace: /r1`"),
    (PEERS, 'args: "--ros-args -r __node:=cam -r __ns:=/r1"', "error", "would be /r1/cam"),
    (PEERS, 'args: [--ros-args, -r, "__node:=n"]', "-", ""),
    (PEERS, 'args: ["__node:=cam"]', "error", "`name: cam`"),
    (
        PEERS,
        'args: [--flag, "__ns:=/r1", --ros-args, -p, "a:=1"]',
        "error",
        "`name: n, namespace: /r1`",
    ),
    (PEERS, 'args: [--ros-args, -p, "__node:=cam"]', "-", ""),
    (PEERS, 'args: [--ros-args, -r, "other:__node:=cam"]', "warning", "`name: cam`"),
    (PEERS, 'args: [--ros-args, -r, "a:=b", -p, "x:=1"]', "-", ""),
    (PEERS, 'args: [--ros-args, -r, "__node:=c"], anonymous: true', "warning", "all its pods"),
    (
        PEERS,
        'args: [bash, -c, "ros2 run p e --ros-args -r __node:=cam"]',
        "warning",
        "`name: cam`",
    ),
]
ROS1 = [
    ("", "env: {ROS_HOSTNAME: localhost}", "error", "cannot connect to localhost"),
    (HOST, "env: {ROS_IP: 'http://10.0.0.4'}", "error", "a protocol or a port"),
    (HOST, "env: {ROS_HOSTNAME: 'robot:11311'}", "error", "a protocol or a port"),
    (HOST, "env: {ROS_IP: 'fd00::4'}", "-", ""),
    ("", "env: {ROS_HOSTNAME: ''}", "error", "an empty address"),
    ("", "env: {ROS_IP: ''}", "error", "an empty address"),
    ("", "env: {ROS_MASTER_URI: 'http://ros-master:11312'}", "warning", "another master"),
    ("", "env: {ROS_HOSTNAME: driver}", "warning", "does not resolve"),
    (HOST, "env: {ROS_HOSTNAME: localhost}", "warning", "cannot connect"),
    (HOST, "env: {ROS_HOSTNAME: robot.local}", "-", ""),
    ("", "env: {ROS_HOSTNAME: $(RIGEL_K8S_POD_IP)}", "-", ""),
    ("", "env: {ROS_IP: 127.0.0.1}", "error", "cannot connect to 127.0.0.1"),
    ("", "env: {ROS_IP: 0.0.0.0}", "error", "cannot connect"),
    ("", "env: {ROS_IP: 192.168.1.5}", "warning", "another address"),
    ("", "env: [{name: ROS_IP, valueFrom: {fieldRef: {fieldPath: status.podIP}}}]", "-", ""),
    ("", "env: {ROS_MASTER_URI: 'http://localhost:11311'}", "error", "no master in the node's pod"),
    ("", "env: {ROS_MASTER_URI: 'http://127.0.0.1:11311/'}", "error", "http://ros-master:11311"),
    ("", "env: {ROS_MASTER_URI: 'ros-master:11311'}", "error", "is not a ROS master's URI"),
    ("", "env: {ROS_MASTER_URI: 'http://ros-master:11311'}", "-", ""),
    ("", "env: {ROS_MASTER_URI: 'http://roscore:11311'}", "warning", "`ros_master_uri`"),
    (
        "ros_master_uri: 'http://robot:11311'",
        "env: {ROS_MASTER_URI: 'http://robot:11311/'}",
        "-",
        "",
    ),
    ("deploy_ros_master: false", "env: {ROS_MASTER_URI: 'http://localhost:11311'}", "-", ""),
    ("", 'args: [--flag, "__master:=http://localhost:1"]', "error", "no master"),
    ("", 'args: ["__ip:=127.0.0.1"]', "error", "cannot connect"),
    ("", 'args: ["__name:=cam"]', "error", "`name: cam`"),
    ("", 'args: ["__name:=n", "__ns:=/"]', "-", ""),
    ("", 'args: ["__ns:=/r1"]', "error", "`name: n, namespace: /r1`"),
    ("", "env: {ROS_NAMESPACE: r1}", "error", "would be /r1/n"),
    ("", "env: {ROS_NAMESPACE: r1}, namespace: /r1", "-", ""),
    ("", "env: {ROS_DOMAIN_ID: 42}", "-", ""),
]


def judge(job: str, node: str, distro: str, other: str = "b: {args: x}") -> tuple[str, str]:
    """Return the severity and the message of the one contradiction; - for none."""
    program = (
        ""
        if "bash" in node or " env, " in node or "[env" in node
        else "package: p, executable: e, "
    )
    if "ros: none" in node:
        program = "args: x, "
    text = f"{{image: a, {job}{',' * bool(job)} nodes: {{n: {{{program}{node}}}, {other}}}}}"
    found = [one for one in problems(text, distro) if one.kind == KIND]
    assert len(found) <= 1
    for one in found:
        assert one.path[:2] in {("nodes", "n"), ("network", "domain_id")}
        assert not one.message.endswith(".")
    return (found[0].severity, found[0].message) if found else ("-", "")


@pytest.mark.parametrize(("job", "node", "severity", "words"), ROS2)
def test_what_defeats_ros2_is_reported(job: str, node: str, severity: str, words: str) -> None:
    """With what to write instead; nothing is said of what works."""
    found, message = judge(job, node, "jazzy")
    assert found == severity, message
    assert words in message


@pytest.mark.parametrize(("job", "node", "severity", "words"), ROS1)
def test_what_defeats_ros1_is_reported(job: str, node: str, severity: str, words: str) -> None:
    """The same for addresses, masters and names of ROS 1."""
    found, message = judge(job, node, "noetic")
    assert found == severity, message
    assert words in message


#: A job of ROS 1, a node, and the severity and place of what is wrong with its master.
MASTERS = [
    ("", "args: roscore", ("error", "nodes.n.args")),
    ("", "command: [/opt/ros/noetic/bin/roscore]", ("error", "nodes.n.command")),
    ("", "args: [bash, -c, 'roscore & rosrun p e']", ("warning", "nodes.n.args")),
    ("ros_master_uri: 'http://robot:11311'", "args: roscore", ("error", "nodes.n.args")),
    ("", "args: [bash, -c, 'wait-for roscore:11311; rosrun p e']", None),
    ("", "args: [wait-for, roscore]", None),
    ("", "ros: none, args: roscore", None),
    ("deploy_ros_master: false", "args: roscore", None),
    ("ros_master_uri: 'http://localhost:11311'", "args: x", ("error", "ros_master_uri")),
    ("ros_master_uri: 'http://localhost:11311', network: host", "args: x", None),
    ("ros_master_uri: 'http://robot:11311'", "args: x", None),
]


@pytest.mark.parametrize(("job", "node", "expected"), MASTERS)
def test_there_is_one_master_that_pods_reach(
    job: str, node: str, expected: tuple[str, str] | None
) -> None:
    """The roscore of a compose file would end, as the nodes have another one."""
    text = f"{{image: a, {job}{',' * bool(job)} nodes: {{n: {{{node}}}, b: {{args: x}}}}}}"
    kinds = (KIND, "two-masters")
    found = [one for one in problems(text, "noetic") if one.kind in kinds]
    places = [(one.severity, ".".join(map(str, one.path))) for one in found]
    assert places == ([expected] if expected else [])


def test_all_nodes_may_be_in_one_domain_of_their_own() -> None:
    """On a wire they find each other in any; with peers they do not."""
    same = "b: {args: x, env: {ROS_DOMAIN_ID: 42}}"
    assert judge(LAN, "env: {ROS_DOMAIN_ID: 42}", "jazzy", same)[0] == "-"


def test_with_peers_all_nodes_are_in_the_domain_of_the_release() -> None:
    """The idiom of a compose file: each service has the same variable."""
    node = "{args: x, env: {ROS_DOMAIN_ID: 42}}"
    found = problems(f"{{image: a, {PEERS}, nodes: {{a: {node}, b: {node}}}}}", "jazzy")
    errors = [one.path[:2] for one in found if one.severity == "error"]
    assert errors == [("nodes", "a"), ("nodes", "b")]


def test_a_single_pod_may_keep_to_itself() -> None:
    """It has no one to find, and an image may start roscore itself."""
    one = "{image: a, %s, nodes: {n: {args: x, env: {%s}}}}"
    for job, env, distro in (
        (PEERS, "ROS_LOCALHOST_ONLY: 1", "jazzy"),
        ("deploy_ros_master: false", "ROS_HOSTNAME: localhost", "noetic"),
    ):
        assert [p for p in problems(one % (job, env), distro) if p.kind == KIND] == []


def test_before_iron_the_range_is_not_read() -> None:
    node = "env: {ROS_AUTOMATIC_DISCOVERY_RANGE: LOCALHOST}"
    assert judge(PEERS, node, "humble")[0] == "-"


def test_the_application_is_compared_too() -> None:
    """Its variables are in additional_k8s_params."""
    patch = PATCH.replace("ros-node", "ros-app") % "{name: ROS_HOSTNAME, value: localhost}"
    text = f"{{application_image: a, additional_k8s_params: {{application: {patch}}}}}"
    found = [p for p in problems(text) if p.kind == KIND]
    place = ("spec", "template", "spec", "containers", 0, "env", 0)
    assert [p.path for p in found] == [("additional_k8s_params", "application", *place)]


def test_every_rule_has_a_case() -> None:
    """A line of the table is here, too."""
    for name in (*RULES["1"], *RULES["2"]):
        assert any(name in node for _, node, severity, _ in (*ROS1, *ROS2) if severity != "-")


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.with.yaml")), ids=lambda p: p.name)
def test_golden_options_contradict_nothing(path: object) -> None:
    text = (GOLDEN / str(path)).read_text("utf-8")
    assert [p for p in problems(text) if p.kind == KIND] == []

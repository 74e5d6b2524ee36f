"""Compose files with the shapes of real robots' become Rigelfiles; each rule alone.

`pytest tests/unit/importing --update-golden` writes the Rigelfiles.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path
from typing import Any

import pytest

from rigel_import.compose.options import ADVICE, READ
from rigel_import.compose.reading import read
from rigel_import.draft import Draft, use_var, write_rigelfile
from rigel_k8s.cli.main import run
from rigel_k8s.errors import UserError

FOLDER = Path(__file__).parent / "compose"
SAMPLES = {"rosbot": "compose.yaml", "wheels": "docker-compose.yml", "cells": "compose.yaml"}


@pytest.mark.parametrize("name", SAMPLES)
def test_a_sample_becomes_its_rigelfile(
    name: str,
    update_golden: bool,  # noqa: FBT001 - a fixture
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is not carried over stands in comments, with its place."""
    monkeypatch.chdir(FOLDER / name)
    text = write_rigelfile(read(Path(SAMPLES[name]), Path()), "rigel import compose")
    golden = Path("Rigelfile")
    if update_golden:
        golden.write_text(text, "utf-8")
    assert text == golden.read_text("utf-8")


@pytest.mark.parametrize("name", SAMPLES)
def test_the_rigelfile_of_a_sample_has_no_errors(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(FOLDER / name)
    monkeypatch.setenv("REGISTRY", "registry.example")
    assert run(["check"], "rigel") == 0, capsys.readouterr()


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def convert(text: str, **files: str) -> Draft:
    """Return the draft of a Compose file in the present directory."""
    for name, content in files.items():
        Path(f".{name}" if name == "env" else f"{name}.yaml").write_text(content)
    Path("compose.yaml").write_text(text)
    return read(Path("compose.yaml"), Path())


def convert_one(entries: str, **files: str) -> tuple[Any, str]:
    """Return the options of a service with these lines, and all remarks as one text."""
    lines = "".join(f"    {line}\n" for line in entries.splitlines())
    draft = convert(f"services:\n  one:\n{lines}", **files)
    remarks = "\n".join(f"{one.place.line}: {one.message}" for one in draft.remarks)
    return draft.nodes["one"], remarks


def test_the_namespace_is_that_of_the_project(project: Path) -> None:
    """As Compose names it: without a name, by the directory."""
    services = "services: {one: {image: a}}\n"
    assert convert(services).name == project.name
    assert convert(services, env="COMPOSE_PROJECT_NAME=fleet").name == "fleet"
    Path(".env").unlink()
    text = write_rigelfile(convert(f"name: my_robot\n{services}"), "rigel import compose")
    assert "    with:\n      namespace: my-robot\n" in text


#: Lines of a service: what its node has, beside what the samples show.
RULES: dict[str, dict[str, Any]] = {
    "command: ros2 launch -d p f.py": {"args": ["ros2", "launch", "-d", "p", "f.py"]},
    "command: [roslaunch, --wait, /x.launch]": {"launch": {"file": "/x.launch"}},
    "command: ros2 launch p f 'b:=x y'": {
        "launch": {"package": "p", "file": "f", "args": {"b": "x y"}},
        "anonymous": None,
    },
    "command: ros2 run p e -v --ros-args --remap __node:=n": {"name": "n", "args": ["-v"]},
    "command: sh -c 'roscore & roslaunch p f'": {"args": ["sh", "-c", "roscore & roslaunch p f"]},
    "environment: [RMW_X=1]": {"ros": None},
    "read_only: true\ncap_drop: [ALL]": {
        "security_context": {"readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
    },
    "user: root:7": {"security_context": {"runAsUser": 0, "runAsGroup": 7}},
    "command: ros2 run --prefix 'gdb -ex' p e": {
        "args": ["ros2", "run", "--prefix", "gdb -ex", "p", "e"]
    },
    "command: ros2 run p e\nentrypoint: []": {
        "command": ["ros2", "run", "p", "e"],
        "package": None,
    },
    "command: x ${NEEDED:?}\nentrypoint: ''": {"command": ["x", use_var("NEEDED")]},
    "command: ros2 run p e": {"anonymous": True, "update": {"strategy": "Recreate"}},
    "devices: ['/dev/a:/dev/b:rw', /dev/c]": {
        "devices": [{"path": "/dev/a", "mount_path": "/dev/b"}, "/dev/c"],
        "security_context": {"privileged": True},
    },
    "devices: [{source: /dev/a, target: /dev/b, permissions: r}]": {
        "devices": [{"path": "/dev/a", "mount_path": "/dev/b"}]
    },
    "devices: ['/dev/dri:/dev/dri']": {
        "volumes": [{"host_path": "/dev/dri", "mount_path": "/dev/dri"}],
        "devices": None,
    },
    "volumes: [{source: bags, target: /b, volume: {subpath: c}}]": {
        "volumes": [{"name": "bags", "mount_path": "/b", "sub_path": "c"}]
    },
    "volumes: ['/dev:/dev:ro,z']": {
        "volumes": [{"host_path": "/dev", "mount_path": "/dev", "read_only": True}]
    },
    "ports: ['81:80', '127.0.0.1:53:53/udp', {target: 7, published: 8}]\nexpose: [9, 80]": {
        "ports": [
            {"port": 80, "service_port": 81},
            {"port": 53, "protocol": "UDP"},
            {"port": 7, "service_port": 8},
            {"port": 9},
        ]
    },
    "ports:\n- 22:22": {"ports": [{"port": 22}]},  # YAML 1.1 reads one number
    "mem_limit: 1.5g\ncpus: 0.5\nmem_reservation: 1g": {
        "resources": {"limits": {"memory": "1.5Gi", "cpu": "0.5"}, "requests": {"memory": "1Gi"}}
    },
    "deploy: {replicas: 3}": {"ros": "none", "replicas": 3},
    "network_mode: host\ncommand: ros2 run p f\ndeploy: {replicas: 3}": {"replicas": 3},
    "command: ros2 launch p g\ndeploy: {replicas: 0}": {"replicas": 0},
    "runtime: nvidia\ngpus: 2": {"resources": {"limits": {"nvidia.com/gpu": 2}}},
    "shm_size: 1gb": {"volumes": [{"memory": "1Gi", "mount_path": "/dev/shm"}]},
    "privileged: ${P:-true}": {"security_context": {"privileged": True}},
}


@pytest.mark.parametrize("entries", RULES)
def test_a_key_becomes_options(entries: str, project: Path) -> None:
    node, _ = convert_one(f"image: example/robot\n{entries}")
    assert {key: node.get(key) for key in RULES[entries]} == RULES[entries]


#: Lines of a service: a part of a remark, with the line in the file.
REMARKS = {
    "user: robot": '4: set runAsUser in `security_context` to the number of the user "robot"',
    "volumes: [/var/run/docker.sock:/x]": "4: /var/run/docker.sock is not mounted: ",
    "volumes: [./base.yaml:/b]": "4: /b is read-only: what the program writes needs a volume",
    "volumes: ['$HOME/.ssh:/s']": "4: ~/.ssh is not mounted at /s",
    "volumes: [{type: image, source: a, target: /a}]": "4: a is not mounted: copy what it needs",
    "volumes: ['bags:/bags']": "4: a volume is empty at first: docker copies what the image has",
    "devices: ['/dev/ttyUSB*']": '4: "/dev/ttyUSB*" is not a device: write its path, or {resource',
    "devices: [nvidia.com/gpu=all]": '4: "nvidia.com/gpu=all" is not a device',
    "ports: ['80:80', '81:80']": "4: 81 is not carried over: 80 has one port already",
    "ports: ['80:80']": "4: ports are open inside of the cluster: for others set `service_type`",
    "volumes: [/cache]": "4: /cache is a part of the pod, and empty in each new one",
    "network_mode: none": "4: `network_mode` is not carried over: each pod has an address of its",
    "deploy: {restart_policy: {condition: none}}": "4: `deploy.restart_policy` is not carried over",
    "runtime: kata": "4: `runtime` is not carried over: set `runtime_class`",
    "build: {target: a, tags: [b]}": "4: `build.tags` is not carried over: set it in the",
    "build: https://example.org/robot.git": "4: its context is not a directory: clone it",
    "secrets: [a]": "4: `secrets` is not carried over: create a Secret",
    "dns: [10.0.0.1]": "4: `dns` is not carried over: set what Kubernetes has",
    "environment: {discovery.type: a}": "4: discovery.type is left out: `env` refuses",
    "networks: {lab: {ipv4_address: 10.0.0.2}}": "4: `networks.lab` is not carried over: a pod",
    'restart: "no"': "4: `restart` is not carried over: Kubernetes starts",
    "env_file: [robot.env]": "4: robot.env does not exist here",
    "environment:\n- ROS_LOCALHOST_ONLY=1": "5: ROS_LOCALHOST_ONLY is left out: `network` decides",
    "environment: [USER]": "4: USER is that of the machine that runs docker compose",
    "environment: [A=$B]": "4: B has no value in .env",
    "command: ros2 launch p f\ndeploy: {replicas: 2}": "5: `deploy.replicas` is not carried over: "
    "ROS allows one node of a name",
    "deploy: {replicas: 2}": "4: `deploy.replicas` is not carried over: with peers, write a node",
    "deploy: {resources: {limits: {pids: 9}}}": "4: `deploy.resources.limits.pids` is not carried",
}


@pytest.mark.parametrize("entries", REMARKS)
def test_what_is_not_carried_over_is_remarked_with_its_line(entries: str, project: Path) -> None:
    _, remarks = convert_one(f"image: example/robot:jazzy\n{entries}", base="")
    assert REMARKS[entries] in remarks


def test_a_folder_elsewhere_is_mounted_once_its_directory_is_trusted(
    project: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The remark has the command, and what to do without it."""
    other = tmp_path_factory.mktemp("scripts")
    (other / "a.py").write_text("print()")
    source = os.path.relpath(other)
    node, remarks = convert_one(f"image: x:jazzy\nvolumes: ['{source}:/rover']")
    assert "files" not in node
    assert re.search(r"is not trusted; .*rigel trust \S+, and import again; or copy it", remarks)


def test_what_changes_nothing_is_not_remarked(project: Path) -> None:
    node, remarks = convert_one(
        "image: x\ntty: true\nrestart: always\nx-y: 1\nipc: host\ndepends_on:\nruntime: runc"
    )
    assert set(node) == {"image", "ros"}
    assert remarks == "2: nothing names a ROS distribution: set application.distro if not lyrical"


def test_a_file_that_overrides_it_is_remarked(project: Path) -> None:
    """Docker Compose merges it, where no file is named."""
    _, remarks = convert_one("image: x:jazzy", **{"compose.override": ""})
    assert "1: this file is not read: import the output of `docker compose config`" in remarks


def test_a_remark_about_several_nodes_is_made_once(project: Path) -> None:
    """The remark stands at its first place, and names the nodes."""
    draft = convert(TWO.format("pid: host", "pid: host"))
    [found] = [one for one in draft.remarks if "`pid`" in one.message]
    assert (str(found.place), found.node) == ("compose.yaml:2", None)
    assert found.message.startswith("a and b: ")


@pytest.mark.parametrize(
    ("text", "written", "values"),
    [
        ("${A:-x}", "{{ vars.A }}", {"A": "x"}),
        ("p-${EMPTY:-x}-s", "p-{{ vars.EMPTY }}-s", {"EMPTY": "x"}),
        ("$GIVEN", "{{ vars.GIVEN }}", {"GIVEN": "g"}),
        ("${GIVEN:+set}${NONE:+no}", "set", {}),
        ("${A:-${GIVEN}}", "{{ vars.A }}", {"A": "g"}),
        ("${A:-two words}", "two words", {}),
        ("$HOME/x", "~/x", {}),
        ("${PWD}/x", "./x", {}),
        ("$$A {{ b }}", '$A {{ "{{" }} b }}', {}),
        ("${NEEDED:?}", "{{ vars.NEEDED }}", {}),
        ("${A-x}${A:-y}", "{{ vars.A }}y", {"A": "x"}),
    ],
)
def test_variables_become_vars(
    text: str, written: str, values: dict[str, str], project: Path
) -> None:
    entries = f"services: {{one: {{image: a:jazzy, environment: {{X: '{text}'}}}}}}"
    draft = convert(entries, env="GIVEN=g\nEMPTY=")
    assert draft.vars == values
    assert f"X: {written}" in write_rigelfile(draft, "c").replace("'", "")


def test_files_of_variables_have_quotes_comments_and_exports(project: Path) -> None:
    Path("robot.env").write_text(
        "export A=1 # one\nB='x # $y'\nC=\n#D=1\nE=\"a\\tb\nc\"\nF=${GIVEN}!"
    )
    entries = "image: x\nenv_file: robot.env\nenvironment: [A=2, GIVEN]"
    node, _ = convert_one(entries, env="G=g h\nGIVEN=$G")
    own = {"A": "2", "B": "x # $y", "C": "", "E": "a\tb\nc", "F": "g h!", "GIVEN": "g h"}
    assert node["env"] == own


def test_files_beside_the_compose_file_are_mounted_where_they_were(project: Path) -> None:
    """Paths in a Rigelfile begin beside it, wherever the Compose file is."""
    Path("docker/maps").mkdir(parents=True)
    Path("docker/maps/lab.pgm").write_bytes(b"P5")
    Path("docker/one.yaml").write_text("a: 1")
    Path("docker/compose.yaml").write_text(
        "services: {a: {image: x:jazzy, build: ..,"
        " volumes: [{type: bind, source: maps, target: /maps, read_only: true},"
        " './one.yaml:/etc/one.yaml:ro', './none:/n']}}"
    )
    draft = read(Path("docker/compose.yaml"), Path())
    files = {"/maps": "docker/maps", "/etc/one.yaml": "docker/one.yaml"}
    assert draft.nodes["a"]["files"] == files
    assert draft.jobs["build_a"]["with"]["context"] == "."
    messages = [one.message for one in draft.remarks]
    assert any("./none is not mounted at /n: cannot read docker/none" in one for one in messages)
    assert not any("read-only" in one for one in messages)


def test_a_folder_that_several_nodes_mount_is_remarked_once(project: Path) -> None:
    """A changed file of it restarts all of them; one that mounts it alone is as expected."""
    for name in ("scripts", "own"):
        Path(name).mkdir()
        Path(name, "a.py").write_text("")
    mounts = "volumes: ['./scripts:/scripts:ro', './{}:/own:ro']"
    draft = convert(TWO.format(mounts.format("own"), mounts.format("scripts/a.py")))
    [found] = [one for one in draft.remarks if "restart" in one.message]
    assert (str(found.place), found.node) == ("compose.yaml:2", None)
    assert found.message.startswith("a and b mount scripts, so all of them restart")


def test_extending_joins_lists_and_named_values_and_replaces_commands(project: Path) -> None:
    base = (
        "services: {b: {image: a:jazzy, command: [x, y], environment: [A=1, B=1],"
        " volumes: ['v:/v', 'w:/w']}}"
    )
    node, _ = convert_one(
        "extends: {file: base.yaml, service: b}\nenvironment: {B: 2}\ncommand: [z]\n"
        "volumes: ['u:/u', 'w:/w']",
        base=base,
    )
    assert (node["image"], node["args"], node["env"]) == ("a:jazzy", ["z"], {"A": "1", "B": "2"})
    assert [one["name"] for one in node["volumes"]] == ["v", "w", "u"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("services: {}", "compose.yaml:1: no `services`"),
        ("include: [a.yaml]", "compose.yaml:1: no `services`"),
        ("- a", "compose.yaml:1: this is not a mapping"),
        ("services:\n  a: x", 'compose.yaml:2: the service "a" is not a mapping'),
        ("services:\n  a: {extends: b}", 'compose.yaml:2: no service "b" in compose.yaml'),
        ("services:\n  a: {extends: a}", 'compose.yaml:2: "a" extends itself'),
        ("services:\n  a: {}", 'compose.yaml:2: the service "a" has neither'),
        ("services:\n  a: {image: x, command: x '}", "compose.yaml:2: the command cannot be split"),
        ("services:\n  a: {image: [x]}", "compose.yaml:2: expected a single value"),
        ("services:\n  a: {image: x, shm_size: y}", 'compose.yaml:2: "y" is not an amount of'),
        ("services: {a: {extends: {file: b.yaml}}}", "cannot read b.yaml"),
    ],
)
def test_an_error_names_the_place_and_the_way_out(text: str, message: str, project: Path) -> None:
    with pytest.raises(UserError) as caught:
        convert(text)
    assert str(caught.value).startswith(message)
    assert caught.value.hint


TWO = "services:\n  a: {{image: x:jazzy, {0}}}\n  b: {{image: x:jazzy, {1}}}\n"
ZENOH = "environment: [RMW_IMPLEMENTATION=rmw_zenoh_cpp]"
HOST, SHARED = "network_mode: host", {"mode": "host", "shared_memory": True}


@pytest.mark.parametrize(
    ("first", "second", "network"),
    [
        (HOST, HOST, {"mode": "host"}),
        (HOST, "tty: true", {"mode": "peers"}),
        (f"{HOST}, ipc: host, shm_size: 1g", f"{HOST}, ipc: host", SHARED),
        ("environment: [ROS_DOMAIN_ID=4]", "tty: true", {"mode": "peers"}),
        (ZENOH, ZENOH, {"mode": "zenoh"}),
    ],
)
def test_the_network_is_that_of_all_services(
    first: str, second: str, network: Any, project: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where nodes have the machine's shared memory, `shm_size` does not apply."""
    draft = convert(TWO.format(first, second))
    assert draft.options == {
        "network": network,
        **({"rmw": "rmw_zenoh_cpp"} if first == ZENOH else {}),
    }
    assert "volumes" not in draft.nodes["a"]
    Path("Rigelfile").write_text(write_rigelfile(draft, "c"))
    assert run(["check"], "rigel") == 0, capsys.readouterr()


def test_the_router_of_zenoh_is_that_of_the_network(project: Path) -> None:
    router = f"{ZENOH}, command: ros2 run rmw_zenoh_cpp rmw_zenohd"
    draft = convert(TWO.format(router, f"{ZENOH}, network_mode: host"))
    assert list(draft.nodes) == ["b"]
    assert any("the service a is left out" in one.message for one in draft.remarks)


def test_variables_of_all_nodes_are_options_of_the_job(project: Path) -> None:
    own = (
        f"{HOST}, ipc: host, environment: [RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, ROS_DOMAIN_ID=4]"
    )
    draft = convert(TWO.format(own, own))
    assert draft.options["rmw"] == "rmw_cyclonedds_cpp"
    assert draft.options["network"] == {"mode": "host", "domain_id": 4}
    assert all("env" not in node for node in draft.nodes.values())


def test_a_node_on_the_machines_network_beside_others_says_so(project: Path) -> None:
    draft = convert(TWO.format("network_mode: host, ports: ['80:80']", "tty: true"))
    assert [one.get("host_network") for one in draft.nodes.values()] == [True, None]
    assert "ports" not in draft.nodes["a"]


def test_services_of_the_other_ros_are_left_out_beside_a_bridge(project: Path) -> None:
    master = "  c: {image: 'ros:noetic', command: roscore}\n"
    bridge = "command: ros2 run b b, environment: [ROS_MASTER_URI=x]"
    draft = convert(TWO.format(bridge, "tty: true") + master)
    assert (draft.distro, list(draft.nodes)) == ("jazzy", ["a", "b"])
    assert draft.nodes["a"]["env"] == {"ROS_MASTER_URI": "x"}
    assert any("the service c is left out: it is ROS 1" in r.message for r in draft.remarks)


def test_a_master_in_the_environment_shows_ros_1(project: Path) -> None:
    draft = convert("services: {a: {image: x, environment: [ROS_MASTER_URI=http://a:11311]}}")
    assert (draft.distro, draft.nodes["a"].get("env")) == ("noetic", None)
    assert any("set `ros_master_uri`" in one.message for one in draft.remarks)


def test_the_distribution_is_that_of_the_dockerfile_or_a_path(project: Path) -> None:
    Path("Dockerfile").write_text("FROM ros:humble AS base\n")
    assert convert("services: {a: {build: .}}").distro == "humble"
    assert convert("services: {a: {image: x, command: /opt/ros/iron/x}}").distro == "iron"


def test_an_image_is_built_once_and_has_a_registry(project: Path) -> None:
    build = "image: robot, build: {context: ws, args: {A: 1}}, command: ros2 launch p f"
    draft = convert(TWO.replace("image: x:jazzy, ", "").format(build, build))
    assert list(draft.jobs) == ["build_a"]
    options = draft.jobs["build_a"]["with"]
    assert (options["context"], options["buildargs"]) == ("ws", {"A": "1"})
    assert draft.nodes["b"]["image"] == options["image"]
    assert draft.vars == {"registry": "registry.example/me"}
    draft = convert("services: {a: {image: r/ros, build: {dockerfile: D}}}")
    assert draft.jobs["build_a"]["with"]["image"] == draft.nodes["a"]["image"] == "r/ros"
    assert "ros" not in draft.nodes["a"]
    assert draft.jobs["build_a"]["with"]["dockerfile"] == "D"


def test_names_are_those_of_ros_and_kubernetes(project: Path) -> None:
    draft = convert("services: {a-b: {image: x}, a_b: {image: y, volumes: ['My_Bags:/b']}}")
    assert list(draft.nodes) == ["a_b", "a_b_2"]
    assert draft.nodes["a_b_2"]["volumes"] == [{"name": "my-bags", "mount_path": "/b"}]
    assert draft.options["persistent_storage"] == {"volumes": [{"name": "my-bags"}]}
    assert draft.options["network"] == {"mode": "none"}


#: Values of a wrong shape, and of an unusual one.
SHAPES = ("", "[]", "{}", "x", "5", "true", "[{}]", "{a: {}}", "[[x]]", "{a: [x]}", "':'", "[':']")


@pytest.mark.parametrize(
    "key", [*sorted(READ), *ADVICE, "extends", "build: {args", "deploy: {resources"]
)
def test_a_value_of_any_shape_is_read_or_refused(key: str, project: Path) -> None:
    for shape in SHAPES:
        end = "}" if "{" in key else ""
        with contextlib.suppress(UserError):
            convert(f"services:\n  one:\n    image: a:jazzy\n    {key}: {shape}{end}\n")


def test_a_port_that_others_name_is_open(project: Path) -> None:
    """Docker Compose opens all ports of a service to the others."""
    uri = "environment: [DB=postgres://b:5432/x, OTHER=a.b:1], command: run b:5432 c-b:2"
    draft = convert(TWO.format(uri, "tty: true"))
    assert [node.get("ports") for node in draft.nodes.values()] == [None, [{"port": 5432}]]


def test_what_others_await_runs_once(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the conditions, this one alone says that a program ends."""
    made = convert(
        "services:\n"
        "  spawn: {image: 'ros:jazzy', gpus: all, command: ros2 run arm spawn}\n"
        "  arm: {image: 'ros:jazzy', command: ros2 run arm arm}\n"
        "  ui:\n    image: ros:jazzy\n    command: ros2 run ui ui\n    depends_on:\n"
        "      spawn: {condition: service_completed_successfully}\n"
        "      arm: {condition: service_started}\n"
    )
    assert {key: node.get("kind") for key, node in made.nodes.items()} == {
        "spawn": "task",
        "arm": None,
        "ui": None,
    }
    Path("Rigelfile").write_text(write_rigelfile(made, "c"))
    assert run(["check"], "rigel") == 0, capsys.readouterr()

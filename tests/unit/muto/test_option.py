"""`muto` in a job: the stack's nodes are the job's, and the Rigelfile's own are laid over them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.app.desired import draft
from rigel_k8s.app.generation import Texts
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.cli.main import run
from rigel_k8s.commands import rigelfiles
from rigel_k8s.commands.targets import TargetJob, job_of, read_jobs
from rigel_k8s.errors import ProblemsError
from rigel_k8s.jobs.types.orchestration import OrchestrationJob
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rigelfile import load, realise
from rigel_k8s.rigelfile.source import Source, node_of
from rigel_k8s.settings import Settings
from rigel_k8s.system.trust import trust
from rigel_muto.reading import read

from .shapes import FOLDER, SAMPLES

SCRIPTS = {"ready.sh": "exit 0\n", "stop.sh": "exit 0\n"}

TALKER = {"name": "talker", "pkg": "demo", "exec": "talker", "args": "$(dirname)/a"}
LISTENER = {"name": "listener", "namespace": "r1", "pkg": "demo", "exec": "listener"}


def write(
    directory: Path, *nodes: dict[str, Any], muto: Any = "stack.json", **options: Any
) -> Path:
    """Write a stack, and a Rigelfile that deploys it."""
    (directory / "stack.json").write_text(json.dumps({"stackId": "org:s", "node": nodes}, indent=1))
    job = {"image": "robot:1", "muto": muto, **options}
    path = directory / "Rigelfile"
    deploy = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}
    path.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": {"deploy": deploy}}))
    return path


def findings(path: Path) -> list[tuple[str, int, str, str]]:
    """Return file, line, kind and severity of what `rigel check` finds."""
    result = rigelfiles.check(Settings(rigelfile=path))
    return [
        (Path((f.source or result.source).name).name, f.span.line, f.kind, f.severity)
        for f in result.findings
    ]


def deploy(path: Path) -> TargetJob:
    return job_of(Settings(rigelfile=path), None)


def test_the_rigelfile_is_laid_over_the_stack(tmp_path: Path) -> None:
    """Mappings are merged by key, lists and texts replaced, null removes; other keys are new."""
    own = {
        "talker": {"args": "--fast", "parameters": {"rate": 5, "old": None}, "ports": [80]},
        "r1/listener": None,
        "extra": {"package": "demo", "executable": "extra"},
    }
    param = [
        {"name": "rate", "value": "1"},
        {"name": "old", "value": "1"},
        {"name": "a", "value": 1},
    ]
    path = write(tmp_path, {**TALKER, "param": param}, LISTENER, nodes=own)
    assert findings(path) == []
    nodes = deploy(path).options.nodes
    assert list(nodes) == ["talker", "extra"]
    assert nodes["talker"].args == "--fast"
    assert nodes["talker"].parameters == {"rate": 5, "a": 1}
    assert nodes["talker"].package == "demo"
    assert nodes["talker"].ports == [80]


def test_a_loss_is_a_warning_until_the_rigelfile_makes_it_good(tmp_path: Path) -> None:
    """Other options of the node do not silence it; `strict` makes an error of it."""
    lost = ("stack.json", 8, "needs-container", "warning")
    assert findings(write(tmp_path, TALKER)) == [lost]
    assert findings(write(tmp_path, TALKER, nodes={"talker": {"ports": [80]}})) == [lost]
    assert findings(write(tmp_path, TALKER, nodes={"talker": {"args": "x"}})) == []
    strict = {"stack": "stack.json", "strict": True}
    assert findings(write(tmp_path, TALKER, muto=strict)) == [(*lost[:3], "error")]
    assert findings(write(tmp_path, TALKER, muto=strict, nodes={"talker": {"args": "x"}})) == []


def test_one_parameter_makes_no_other_one_good(tmp_path: Path) -> None:
    """Nor does a variable; what the warning names must be there."""
    param = [{"name": name, "value": "$(anon X)"} for name in ("a", "b")]
    lost = {**LISTENER, "param": param, "env": [{"name": "C", "value": "$(anon X)"}]}
    own = {"parameters": {"a": 1}, "env": {"D": 1}}
    path = write(tmp_path, lost, nodes={"r1/listener": own})
    assert [found[1] for found in findings(path)] == [16, 22]
    own = {"parameters": {"a": 1, "b": 2}, "env": {"C": 1}}
    assert findings(write(tmp_path, lost, nodes={"r1/listener": own})) == []


def write_globals(directory: Path, **more: Any) -> Path:
    """Write two stacks with global parameters, of which one refers to the other."""
    path = write(directory, LISTENER, **more)
    base = {
        "stackId": "org:base",
        "param": [{"name": "a", "value": 1}, {"name": "b", "value": 2}, {"from": "/base.yaml"}],
    }
    upper = {
        **json.loads((directory / "stack.json").read_text()),
        "param": [{"name": "b", "value": "$(env B)"}, {"from": "/upper.yaml", "namespace": "n"}],
        "stack": [{"thingId": "org:base"}],
    }
    (directory / "base.json").write_text(json.dumps(base))
    (directory / "stack.json").write_text(json.dumps(upper, indent=1))
    return path


def test_global_parameters_of_stacks_are_laid_over_each_other(tmp_path: Path) -> None:
    """Those of a stack that it refers to come first, those of the Rigelfile last."""
    options = deploy(write_globals(tmp_path, parameters={"a": None, "c": 3})).options
    assert options.parameters == {"b": "$(env B)", "c": 3}
    assert [(str(f.image_file), f.namespace) for f in options.parameter_files] == [
        ("/base.yaml", None),
        ("/upper.yaml", "n"),
    ]
    assert options.substitution_args is True
    assert not options.nodes["r1/listener"].substitution_args


def test_global_parameters_are_refused_in_ros2_at_their_place(tmp_path: Path) -> None:
    """A stack without a form of its own may be for either; `null` removes what ROS 2 lacks."""
    path = write_globals(tmp_path, ros="2")
    wrong = [found for found in findings(path) if found[2] == "no-global-parameters"]
    assert wrong
    assert {(file, severity) for file, _, _, severity in wrong} == {("stack.json", "error")}
    own = {"parameters": {"a": None, "b": None}, "parameter_files": []}
    path = write_globals(tmp_path, ros="2", network="none", substitution_args=False, **own)
    assert findings(path) == []


def test_a_global_parameter_of_the_rigelfile_makes_a_lost_one_good(tmp_path: Path) -> None:
    """As one of a node does; another one does not."""
    path = write(tmp_path, LISTENER, parameters={"other": 1})
    stack = json.loads((tmp_path / "stack.json").read_text())
    lost = {**stack, "param": [{"name": "home", "value": "$(dirname)"}]}
    (tmp_path / "stack.json").write_text(json.dumps(lost))
    assert findings(path) == [("stack.json", 1, "needs-container", "warning")]
    write(tmp_path, LISTENER, parameters={"home": "/"})
    (tmp_path / "stack.json").write_text(json.dumps(lost))
    assert findings(path) == []


def test_a_prefix_is_made_good_by_a_line_of_ones_own(tmp_path: Path) -> None:
    """As its warning says."""
    prefixed = {**LISTENER, "launch-prefix": "nice"}
    assert [found[2] for found in findings(write(tmp_path, prefixed))] == ["not-carried"]
    own = {"package": None, "executable": None, "args": "nice rosrun demo listener"}
    path = write(tmp_path, prefixed, nodes={"r1/listener": own})
    assert findings(path) == []
    assert deploy(path).options.nodes["r1/listener"].package is None


def test_a_nodelet_is_a_component_of_its_manager(tmp_path: Path) -> None:
    """What it loses names the path of the component, whose options make it good."""
    manager = {"name": "m", "pkg": "nodelet", "exec": "nodelet", "args": "manager"}
    load = {"name": "l", "pkg": "nodelet", "exec": "nodelet", "args": "load a/B m", "cwd": "node"}
    left_out = {**load, "if": "0"}
    lost = {**load, "param": [{"name": "map", "command": "cat map"}]}
    found = findings(write(tmp_path, manager, lost, left_out))
    assert {kind for _, _, kind, _ in found} == {"left-out", "not-carried", "needs-container"}
    own = {"m": {"components": {"l": {"parameters": {"map": 1}}}}}
    path = write(tmp_path, manager, lost, nodes=own)
    assert [kind for _, _, kind, _ in findings(path)] == ["not-carried"]
    (node,) = deploy(path).options.nodes.values()
    assert (node.components["l"].plugin, node.components["l"].parameters) == ("a/B", {"map": 1})


def test_a_manager_completes_what_its_nodelets_have(tmp_path: Path) -> None:
    """But parameters from programs are lost, until the Rigelfile has them as `parameters`."""
    manager = {"name": "m", "pkg": "nodelet", "exec": "nodelet", "args": "manager"}
    load = {"name": "l", "pkg": "nodelet", "exec": "nodelet", "args": "load $(env EYE) m"}
    load["param"] = [{"name": "urdf", "command": "xacro $(find a)/a.urdf"}]
    (lost,) = findings(write(tmp_path, manager, load))
    assert lost[2:] == ("needs-container", "warning")
    own = {"m": {"components": {"l": {"parameters": {"urdf": "<robot/>"}}}}}
    path = write(tmp_path, manager, load, nodes=own)
    assert findings(path) == []
    node = deploy(path).options.nodes["m"]
    assert node.components["l"].plugin == "$(env EYE)"
    assert node.substitution_args


def test_a_lifecycle_without_transitions_is_lost_only(tmp_path: Path) -> None:
    """A key of it that has no counterpart leaves nothing behind that the job would refuse."""
    path = write(tmp_path, {**LISTENER, "lifecycle": {"kill": ["shutdown"]}})
    assert [(kind, severity) for _, _, kind, severity in findings(path)] == [
        ("not-carried", "warning")
    ]
    assert deploy(path).options.nodes["r1/listener"].lifecycle is None


def test_a_stack_without_programs_needs_nodes_of_the_rigelfile(tmp_path: Path) -> None:
    """One that is all composable nodes is deployed by them."""
    assert [found[2] for found in findings(write(tmp_path))] == ["no-node"]
    own = {"eye": {"launch": {"package": "car", "file": "eye.launch"}}}
    assert findings(write(tmp_path, nodes=own)) == []


def test_warnings_of_a_stack_come_with_render_and_diff(tmp_path: Path) -> None:
    """They are part of what the commands on a job print."""
    (warning,) = deploy(write(tmp_path, TALKER)).warnings.texts
    assert "$(dirname) is none of $(find PACKAGE)" in warning


def test_a_wrong_value_of_a_stack_is_reported_in_the_stack(tmp_path: Path) -> None:
    """What the job's own checks find wrong has the stack's place, keys of nodes included."""
    wrong = {"name": "a-b", "pkg": "p", "exec": "e", "param": [{"name": "x y", "value": 1}]}
    bad_map = {"name": "c", "pkg": "p", "exec": "e", "remap": [{"from": "a", "to": "b c"}]}
    assert findings(write(tmp_path, wrong, bad_map)) == [
        ("stack.json", 5, "bad-ros-name", "error"),
        ("stack.json", 10, "bad-ros-name", "error"),
        ("stack.json", 22, "bad-ros-name", "error"),
    ]


@pytest.mark.parametrize(
    ("node", "kind"),
    [
        ({"env": [{"name": "ROS_DOMAIN_ID", "value": "42"}]}, "contradiction"),
        ({"remap": [{"from": "~input", "to": "/x"}]}, "bad-ros-name"),
        ({"param": [{"name": "a", "value": []}]}, "bad-parameter"),
        ({"param": [{"name": "ros__parameters", "value": {"a": 1}}]}, "bad-parameter"),
        ({"args": "--ros-args -r __node:=cam"}, "contradiction"),
        ({"args": "_rate:=5"}, "ros-args"),
        ({"exec": "a.launch.py"}, "bad-command"),
        ({"remap": [{"from": "~/input", "to": "/x"}]}, None),
    ],
)
def test_what_ros2_would_not_do_is_reported_in_the_stack(
    tmp_path: Path, node: dict[str, Any], kind: str | None
) -> None:
    own = {"name": "talker", "pkg": "demo", "exec": "talker", **node}
    path = write(tmp_path, own, LISTENER, ros="2", network="peers")
    found = [(file, one) for file, _, one, _ in findings(path)]
    assert found == ([("stack.json", kind)] if kind else [])


def test_a_wrong_value_beside_the_stack_is_reported_in_the_rigelfile(tmp_path: Path) -> None:
    own = {"talker": {"args": "x", "replicas": 2}}
    assert findings(write(tmp_path, TALKER, nodes=own)) == [
        ("Rigelfile", 1, "duplicate-node", "error")
    ]


@pytest.mark.parametrize(
    ("muto", "kind"),
    [
        ({}, "missing-key"),
        ({"stack": "stack.json", "arg": {}}, "unknown-key"),
        ("nowhere.json", "unknown-stack"),
        ("org:nowhere", "unknown-stack"),
        ({"stack": "stack.json", "args": {"x": 1}}, "unknown-argument"),
        (".", "unknown-stack"),
        ("9" * 300, "unknown-stack"),
        ("9" * 300 + ".json", "unknown-stack"),
        ("a\0b.json", "bad-file"),
        ("http://a:99999", "bad-value"),
    ],
)
def test_what_is_wrong_with_the_option_is_all_that_is_reported(
    tmp_path: Path, muto: Any, kind: str
) -> None:
    """A job whose stack is unknown is not said to have no nodes."""
    path = write(tmp_path, LISTENER, muto=muto, nodes={"talker": {"ports": [80]}})
    assert [found[2] for found in findings(path)] == [kind]
    with pytest.raises(ProblemsError):
        deploy(path)


def test_a_stack_is_found_by_its_id(tmp_path: Path) -> None:
    """The files of the application's directory are looked into."""
    assert list(deploy(write(tmp_path, LISTENER, muto="org:s")).options.nodes) == ["r1/listener"]


def test_a_stack_outside_of_the_rigelfiles_directory_needs_trust(tmp_path: Path) -> None:
    """So does one that a symbolic link leads to, by its name and by its id."""
    inside = tmp_path / "robot"
    inside.mkdir()
    write(tmp_path, LISTENER)
    path = write(inside, LISTENER, muto="../stack.json")
    assert [found[2] for found in findings(path)] == ["untrusted"]
    path = write(inside, LISTENER, muto="link.json")
    (inside / "stack.json").unlink()
    (inside / "link.json").symlink_to(tmp_path / "stack.json")
    assert [found[2] for found in findings(path)] == ["untrusted"]
    by_id = path.read_text().replace("link.json", "org:s")
    path.write_text(by_id)
    assert [found[2] for found in findings(path)] == ["unknown-stack"]
    trust(inside)
    assert findings(path) == []


def test_a_stack_that_an_earlier_job_names_is_looked_at_when_it_is_known(tmp_path: Path) -> None:
    """Until then nothing is reported, and the release has its name."""
    path = write(tmp_path, LISTENER, muto={"stack": "{{ data.stack }}"}, deployment_name="robot")
    assert findings(path) == []
    jobs = read_jobs(Settings(path))
    assert str(jobs.read_names(jobs.choose("deploy")).deployment_name) == "robot"


def test_a_revision_records_nodes_and_no_stack(tmp_path: Path) -> None:
    """So a rollback, or a job that describes a part, needs no file."""
    raw = deploy(write(tmp_path, LISTENER)).context.raw
    assert raw["nodes"] == {"r1/listener": {"package": "demo", "executable": "listener"}}
    assert "muto" not in raw


def test_an_entry_that_is_probably_misspelt_is_remarked_on(tmp_path: Path) -> None:
    """It would be a further node, which runs what the image runs."""
    path = write(tmp_path, LISTENER, nodes={"r1/listner": {"ports": [80]}})
    assert findings(path) == [("Rigelfile", 1, "unknown-node", "warning")]
    whole = {"package": "demo", "executable": "listener"}
    assert findings(write(tmp_path, LISTENER, nodes={"r1/listner": whole})) == []


def test_findings_as_json_name_the_stacks_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Editors and CI show them where they are."""
    assert run(["-f", str(write(tmp_path, TALKER)), "check", "-o", "json"], "rigel") == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["file"] == str(tmp_path / "stack.json")
    assert found["line"] == 8


def test_a_template_in_a_stack_is_text(tmp_path: Path) -> None:
    """A stack cannot read the environment of those who deploy it."""
    path = write(tmp_path, {**LISTENER, "args": "{{ vars.HOME }}"})
    assert findings(path) == []
    assert deploy(path).options.nodes["r1/listener"].args == "{{ vars.HOME }}"


def objects_of(rigelfile: Path) -> list[dict[str, Any]]:
    """Return the objects that a Rigelfile's one job deploys; it must be right."""
    result = rigelfiles.check(Settings(rigelfile=rigelfile))
    assert not result.errors, result.render_findings()
    loaded = load(rigelfile)
    made = realise(loaded, loaded.jobs["deploy"], None, {}, OrchestrationJob.options)
    assert "muto" not in made.raw
    release = ReleaseId("robots", "stack")
    drafted = draft(made.options, release, loaded.application, Texts(SCRIPTS))
    return list(drafted.finish(raw=made.raw).objects)


@pytest.mark.parametrize("name", SAMPLES)
def test_the_option_and_the_rigelfile_deploy_the_same(name: str, tmp_path: Path) -> None:
    """A converted Rigelfile passes `rigel check`, and its objects are those of `muto: STACK`."""
    directory, stack = SAMPLES[name]
    golden = FOLDER / f"{name}.Rigelfile"
    text = golden.read_text("utf-8")
    before, _, _ = text.partition("      nodes:\n")
    for file in (FOLDER / directory).glob("*.json"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    option = tmp_path / "Rigelfile"
    option.write_text(f"{before}      muto: {stack}\n", "utf-8")
    converted = objects_of(golden)
    assert any(item["kind"] == "Deployment" for item in converted)
    assert converted == objects_of(option)


def test_a_stack_may_stand_in_the_rigelfile(tmp_path: Path) -> None:
    """Its references are found in the application's directory."""
    other = {"stackId": "org:other", "node": [LISTENER]}
    (tmp_path / "other.json").write_text(json.dumps(other))
    stack = {"node": [TALKER], "stack": [{"thingId": "org:other"}]}
    path = write(tmp_path, muto={"stack": stack})
    assert list(deploy(path).options.nodes) == ["r1/listener", "talker"]


@pytest.mark.parametrize("stack", [{}, {"node": 1}, {"nodes": []}, "data:;base64,e30="])
def test_a_value_that_is_no_stack_is_an_error(tmp_path: Path, stack: object) -> None:
    path = write(tmp_path, muto={"stack": stack})
    assert [severity for *_, severity in findings(path)] == ["error"]


def test_braces_of_another_file_are_text(tmp_path: Path) -> None:
    """In keys and values: the sender of a stack must not read the environment here."""
    text = json.dumps({"node": [{**TALKER, "args": "{{ vars.HOME }}", "{{ vars.HOME }}": 1}]})
    (tmp_path / "a").mkdir()
    rigelfile = load(write(tmp_path, muto={"stack": "a"}))
    spec = rigelfile.jobs["deploy"]
    stack = {"muto": node_of({"stack": ""}, spec.options)}
    stack["muto"].value["stack"] = read(Source("stack", text))
    override = attrs.evolve(spec.options, value=stack)
    made = realise(rigelfile, spec, override, {}, OrchestrationOptions)
    assert made.options.nodes["talker"].args == "{{ vars.HOME }}"
    assert "{{ vars.HOME }}" in str(made.findings)


def test_arguments_are_filled_into_names(tmp_path: Path) -> None:
    """Of nodes and of their namespaces."""
    node = {**LISTENER, "name": "$(arg side)_eye", "namespace": "$(arg robot)"}
    path = write(tmp_path, node)
    stack = json.loads((tmp_path / "stack.json").read_text())
    stack["arg"] = [{"name": "side", "value": "left"}, {"name": "robot", "default": "r7"}]
    (tmp_path / "stack.json").write_text(json.dumps(stack))
    assert list(deploy(path).options.nodes) == ["r7/left_eye"]

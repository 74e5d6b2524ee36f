"""Launch files become Rigelfiles that mean the same; what does not is a remark, with its place.

`pytest tests/unit/importing --update-golden` writes the golden Rigelfiles.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from rigel_import.draft import Draft
from rigel_import.launch.packages import find_launch_file, find_packages, find_workspace
from rigel_import.launch.reading import read
from rigel_k8s.cli.main import run
from rigel_k8s.errors import UserError

FOLDER = Path(__file__).parent / "launch"
MORE = "src/rover_bringup/launch/more.launch.yaml"
#: Golden Rigelfiles by name: the workspace, and the words of the command.
SAMPLES = {
    "ros1": ("ros1", "src/rover_bringup/launch/rover.launch"),
    "ros2": ("ros2", "src/rover_bringup/launch/rover.launch.xml"),
    "ros2-yaml": ("ros2", MORE, "--image", "registry.example/r:1", "--arg", "speed=2.5"),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_a_sample_becomes_its_rigelfile(
    name: str,
    update_golden: bool,  # noqa: FBT001 - a fixture
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`rigel check` accepts it."""
    workspace, *words = SAMPLES[name]
    monkeypatch.chdir(shutil.copytree(FOLDER / workspace, tmp_path / "w"))
    assert run(["import", "launch", *words], "rigel") == 0
    golden = FOLDER / f"{name}.Rigelfile"
    if update_golden:
        shutil.copy("Rigelfile", golden)
    assert Path("Rigelfile").read_text() == golden.read_text()
    assert "Next: `rigel check`" in capsys.readouterr().out
    assert run(["check"], "rigel") == 0, capsys.readouterr().out


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run each test in an empty directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def convert(text: str, name: str = "a.launch", **args: str) -> Draft:
    """Return a launch file's draft; the tag around it may be left out."""
    whole = text if name.endswith("yaml") or "<launch>" in text else f"<launch>{text}</launch>"
    Path(name).write_text(whole)
    return read(Path(name), args, {}, "r:1")


def convert_one(text: str, name: str = "a.launch", **args: str) -> dict[str, Any]:
    (options,) = convert(text, name, **args).nodes.values()
    return dict(options)


def list_remarks(draft: Draft) -> str:
    return "\n".join(f"{remark.place}: {remark.message}" for remark in draft.remarks)


def add_package(name: str, directory: str = "src", **files: str) -> Path:
    """Write a package with launch files."""
    package = Path(directory) / name
    (package / "launch").mkdir(parents=True)
    (package / "package.xml").write_text(f"<package><name>{name}</name></package>")
    for file, text in files.items():
        (package / "launch" / f"{file}.launch").write_text(f"<launch>{text}</launch>")
    return package


NODE = '<node pkg="p" type="t" name="n"/>'
NODE2 = '<node pkg="p" exec="t" name="n"/>'
PROGRAM = {"package": "p", "executable": "t"}


# The image


@pytest.mark.parametrize(
    ("node", "mounts"),
    [('type="t"', True), ('exec="t"', False), ('exec="t" args="$(find-pkg-share rover)"', False)],
)
def test_packages_of_the_workspace_must_be_in_the_image(node: str, mounts: bool) -> None:  # noqa: FBT001
    """The first remark names them and the way on, also if an image is given."""
    pkg = "p" if "find" in node else "rover"
    rover = add_package("rover", robot=f'<node pkg="{pkg}" name="n" {node}/>')
    add_package("unused")
    remark = read(rover / "launch/robot.launch", {}, {}, "r:1", None).remarks[0].message
    assert remark.startswith(
        "the image must have the package rover: build one from this workspace with jobs of"
        " rigel_k8s.DockerfilePlugin and rigel_k8s.BuildXPlugin"
    )
    mount = "or mount a folder of scripts at /opt/ros/noetic/share/PACKAGE with `files`"
    assert (mount in remark) is mounts


# Conditions and arguments


@pytest.mark.parametrize(
    ("condition", "kept"),
    [
        ('if="true"', True),
        ('unless="1"', False),
        ('unless="False"', True),
        ('if="$(arg on)"', True),
        ('if="$(eval on and not off)"', True),
        ('if="$(eval off or on)"', True),
        ("""if="$(eval arg('mode') == 'slow')\"""", False),
        ('if="$(eval size >= 3)"', True),
        ("""if="$(eval 'yes' if off else false)\"""", False),
        ("""if="$(eval '\\'$(arg mode)\\' == \\'fast\\'')\"""", True),
        ('if="$(optenv X false)"', False),
        ('if="$(eval variable)"', True),
        ("""if="$(eval mode in ['slow', 'fast'])\"""", True),
        ('if="$(not $(arg off))"', True),
        ('if="$(and $(arg on) $(arg off))"', False),
        ('if="$(or $(arg off) True)"', True),
        ('if="$(var none false)"', False),
    ],
)
def test_a_condition_decides(condition: str, kept: bool) -> None:  # noqa: FBT001
    """It may have true, false, 1, 0, arguments, and comparisons of them."""
    values = {"on": "true", "off": "false", "mode": "fast", "size": 3, "variable": "$(env X 1)"}
    args = "".join(f'<arg name="{name}" default="{text}"/>' for name, text in values.items())
    text = f'{args}<node pkg="p" type="t" name="m"/><node pkg="p" type="t" name="n" {condition}/>'
    assert ("n" in convert(text).nodes) is kept


@pytest.mark.parametrize(
    "expression",
    [
        "__import__('os').getcwd()",
        "(1).__class__",
        "'a' * 9",
        "open('x')",
        "pi",
        "1 +",
        "'a' &lt; 1",
    ],
)
def test_eval_is_not_pythons(expression: str) -> None:
    """What is not a comparison or a truth is never evaluated; the remark has the line."""
    text = f'<launch>\n{NODE}\n<param name="a" value="$(eval {expression})"/></launch>'
    draft = convert(text)
    assert "a.launch:3: `param` is left out" in list_remarks(draft)
    assert "parameters" not in draft.options


def test_an_argument_that_is_not_known_is_a_remark_where_it_is_used() -> None:
    text = f"""<launch><arg name="a" default="$(eval env('X'))"/>{NODE}
      <env name="b" value="$(arg a)"/></launch>"""
    remarks = list_remarks(convert(text))
    assert "a.launch:1: `arg` has a value that is not known here" in remarks
    assert "a.launch:2: `env` is left out: the argument `a` is not known here; set it" in remarks
    assert not convert(text, a="1").remarks


def test_a_given_argument_wins() -> None:
    text = '<arg name="a" default="1"/><arg name="b" value="x$(arg a)"/>'
    text += '<node pkg="p" type="t" name="n" args="$(arg b) $(env HOME)"/>'
    assert convert_one(text)["args"] == "x1 $(env HOME)"
    assert convert_one(text, a="2")["args"] == "x2 $(env HOME)"
    assert convert_one(text)["substitution_args"] is True


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        (f'<arg name="a"/>{NODE}', 'a.launch:1: the argument "a" has no value', "--arg a=VALUE"),
        (
            '<arg name="robot" default=""/><env name="x" value="$(arg robto)"/>',
            '"robto", did',
            "arg",
        ),
        ('<node name="n" pkg="p" type="$(arg x)"/>', 'unknown argument "x"', "declare it"),
        ('<node name="n" type="t"/>', '`node` needs the attribute "pkg"', "add pkg"),
        (NODE[:-2] + ' if="yes"/>', 'must be true, false, 1 or 0, got "yes"', "correct it"),
        ("launch: 1", "1: a launch file in YAML is a mapping with the list", "begin it with"),
        ("launch:\n- a", "a.launch.yaml:2: an action must be a mapping with one key", "write it"),
        ("launch:\n- a: [", "a.launch.yaml has 1 problem", ""),
        ("<launch>\n<node></launch>", "a.launch:2: invalid XML: mismatched tag", "correct"),
        ('<group><let name="b" value=""/></group><let name="c" value="$(var b)"/>', '"b"', "arg"),
        (f'{NODE}<include file="a.launch"/>', "it includes itself", "remove one `include`"),
        (f"{NODE}<rosparam>[1, 2]</rosparam>", "this value has no name", "param="),
        (f"{NODE}<rosparam>a: [</rosparam>", "a.launch:1: invalid YAML", "correct"),
        ('<group ns="$(env X)"/>', "no node is started with these arguments", "--arg"),
        ("<group>" * 200 + "</group>" * 200, "more than 100 tags are nested", "include"),
    ],
)
def test_mistakes_have_a_place_and_a_way_out(text: str, message: str, hint: str) -> None:
    with pytest.raises(UserError) as error:
        convert(text, "a.launch.yaml" if text.startswith("launch:") else "a.launch")
    assert message in error.value.message
    assert hint in (error.value.hint or "")


def test_arguments_and_files_are_of_a_launch_file() -> None:
    with pytest.raises(UserError, match='no argument "robto", did you mean "robot"'):
        convert(f'<arg name="robot" default=""/>{NODE}', robto="x")
    Path("robot.urdf").write_text("<robot>\n<link/></robot>")
    for name, message in (("robot.urdf", "1: the first tag is `robot`"), ("no.launch", "cannot r")):
        with pytest.raises(UserError, match=message):
            read(Path(name), {}, {})


def test_a_text_that_grows_has_an_end() -> None:
    args = "".join(f'<arg name="a{n + 1}" value="{f"$(arg a{n})" * 9}"/>' for n in range(20))
    draft = convert(f'<arg name="a0" default="xxxx"/>{args}{NODE}')
    assert "a text becomes longer than" in list_remarks(draft)


# ROS 1


def test_scopes_end_with_their_group() -> None:
    """Remappings, variables and namespaces of a group do not reach the nodes after it."""
    text = f"""<remap from="a" to="b"/><group ns="g"><remap from="c" to="d"/>
      <env name="E" value="1"/><node pkg="p" type="t" name="m" ns="h"/></group>{NODE}"""
    nodes = convert(text).nodes
    assert list(nodes) == ["g/h/m", "n"]
    assert nodes["g/h/m"]["remappings"] == {"a": "b", "c": "d"}
    assert nodes["g/h/m"]["env"] == {"E": "1"}
    assert nodes["n"] == PROGRAM | {"remappings": {"a": "b"}}


def test_the_same_name_twice_is_two_keys() -> None:
    draft = convert(NODE + NODE)
    assert list(draft.nodes) == ["n", "n_2"]
    assert "`n` is already a node, so this one is `n_2`" in list_remarks(draft)


@pytest.mark.parametrize(
    ("attributes", "value"),
    [
        ('value="4"', 4),
        ('value="True"', True),
        ('value="0042" type="str"', "0042"),
        ('value="4" type="double"', 4.0),
        ('value="[1, a]" type="yaml"', [1, "a"]),
        ('value="2026-01-02" type="yaml"', "2026-01-02"),
        ('value="$(env N)" type="int"', "$(env N)"),
    ],
)
def test_parameters_have_the_types_of_roslaunch(attributes: str, value: object) -> None:
    node = f'<node pkg="p" type="t" name="n"><param name="~x" {attributes}/></node>'
    found = convert_one(node)["parameters"]["x"]
    assert (found, type(found)) == (value, type(value))


def test_parameters_outside_of_nodes_are_global() -> None:
    text = f"""<group ns="g"><param name="a" value="1"/>
      <param name="/b" command="xacro  $(find p)/x"/>
      <param name="c" textfile="$(find p)/t"/><rosparam ns="d">e: 1</rosparam>
      <rosparam ns="d">f: 2</rosparam><rosparam file="$(find p)/f.yaml" param="h"/>
      <param name="~q" value="2"/>{NODE}</group>"""
    draft = convert(text)
    assert draft.options["parameters"] == {"g/a": 1, "g/d": {"e": 1, "f": 2}}
    commands = {"b": "xacro $(find p)/x", "g/c": "cat $(find p)/t"}
    assert draft.options["parameter_commands"] == commands
    file = {"image_file": "$(find p)/f.yaml", "namespace": "g/h"}
    assert draft.options["parameter_files"] == [file]
    assert draft.options["substitution_args"] is True
    assert draft.nodes["g/n"]["parameters"] == {"q": 2}


def test_an_include_sees_what_it_is_passed() -> None:
    inner = '<arg name="x" default="0"/><node pkg="p" type="t" name="n" args="$(arg x)"/>'
    add_package("p", inner=inner)
    outer = (
        '<arg name="x" default="1"/><include file="$(find p)/launch/inner.launch" {}>{}</include>'
    )
    arg = '<arg name="x" value="2"/>'
    assert convert_one(outer.format("", ""), "src/a.launch")["args"] == "0"
    passed = convert(outer.format('ns="k"', arg), "src/a.launch")
    assert passed.nodes["k/n"]["args"] == "2"
    every = convert_one(outer.format('pass_all_args="true"', ""), "src/a.launch")
    assert every["args"] == "1"


def test_an_include_that_is_not_here_stays_a_launch_file() -> None:
    text = """<group ns="g"><env name="E" value="1"/><include file="$(find q)/launch/b.launch">
      <arg name="x" value="1"/></include></group>"""
    draft = convert(text)
    launch = {"package": "q", "file": "b.launch", "args": {"x": "1"}}
    assert draft.nodes == {"g/b": {"launch": launch, "env": {"E": "1"}}}
    assert "it is not here; to read it, pass --package q=DIRECTORY" in list_remarks(draft)


def test_a_given_package_wins() -> None:
    add_package("q", b='<node pkg="p" type="t" name="m"/>')
    other = add_package("q", "other", b=NODE)
    Path("src/a.launch").write_text('<launch><include file="$(find q)/launch/b.launch"/></launch>')
    assert list(read(Path("src/a.launch"), {}, {}).nodes) == ["m"]
    assert list(read(Path("src/a.launch"), {}, {"q": other}).nodes) == ["n"]


def test_a_workspace_is_searched_without_what_it_built() -> None:
    """It is `src`, a repository, or the directory above the package."""
    for top, inner in (("src", ""), ("b", ".git"), ("c", "")):
        (Path(top) / inner).mkdir(parents=True)
        first = add_package("one", top if top == "c" else f"{top}/deep")
        second = add_package("two", f"{top}/x")
        add_package("three", f"{top}/install")
        found = find_packages(find_workspace(first / "launch" / "a.launch"))
        assert found["two"] == second.resolve()
        assert "three" not in found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<node pkg="nodelet" type="nodelet" name="n" args="load p/A b"/>', "`components`"),
        (f'{NODE}<rosparam command="delete" param="x"/>', "`rosparam` is left out: `command` is d"),
        (f"{NODE}<rosparam>a: deg(90)</rosparam>", "roslaunch computes angles in it: write"),
        (f"{NODE}<rosparam>a: !degrees 90</rosparam>", "roslaunch computes angles in it: write"),
        (f'{NODE}<param name="x" value="1"/><rosparam file="f"/>', "values before this file win"),
        (
            f'{NODE}<include file="$(find p)/a"><env name="a" value=""/></include>',
            "in a group around",
        ),
        (f'{NODE}<param name="x" binfile="f"/>', "a binary file cannot be a parameter"),
        (f'{NODE}<group if="$(env X)"/>', "only a container knows `$(env X)`; pass --arg, or"),
        (f'{NODE}<group if="$(optenv X 1)"/>', "`$(optenv X 1)` is taken as its default"),
        (f'{NODE}<remap from="a" to="$(find p)"/>', "`remap` is left out: only a container"),
        (f'{NODE}<env name="a" value="$(optenv X $(find p))"/>', "a container cannot replace"),
        (f'{NODE}<env name="a" value="{"$(" * 900}{")" * 900}"/>', "`env` is left out: maximum"),
        (f'{NODE}<env name="a" value="$(dirname)"/>', "`$(dirname)` needs a package.xml"),
        (f'{NODE}<env name="a" value="$(find p"/>', "a closing parenthesis is missing"),
        (f'{NODE}<include file="$(env P)/a.launch"/>', "only a container knows `$(env P)/a.la"),
    ],
)
def test_what_is_not_carried_over_is_a_remark(text: str, message: str) -> None:
    remarks = list_remarks(convert(f'{text}<arg name="_" default="$(find p)"/>'))
    assert message in remarks
    assert remarks.startswith("a.launch:1: ")


def test_a_node_that_is_not_known_leaves_no_trace() -> None:
    draft = convert(f'<node pkg="p" type="$(env T)" name="m"/>{NODE}')
    assert list(draft.nodes) == ["n"]
    assert [remark.node for remark in draft.remarks] == [None]


# ROS 2


def test_settings_of_a_group_end_with_it() -> None:
    """Those of a group that is not scoped do not."""
    inner = """<push_ros_namespace namespace="g"/><set_env name="E" value="1"/>
      <set_remap from="a" to="b"/><set_parameter name="q" value="1.5"/>"""
    whole = PROGRAM | {"env": {"E": "1"}, "remappings": {"a": "b"}, "parameters": {"q": 1.5}}
    text = f"<group>{inner}</group>{NODE2}"
    assert convert(text).nodes == {"n": PROGRAM}
    assert convert(text.replace("<group>", '<group scoped="false">')).nodes == {"g/n": whole}


def test_an_include_ends_with_its_directory() -> None:
    """`$(dirname)` after it is that of the file around it; ROS 2 shares the rest of the scope."""
    add_package("q", b='<let name="x" value="$(dirname)"/>')
    include = '<include file="$(find-pkg-share q)/launch/b.launch"/>'
    node = '<node pkg="p" exec="t" name="n" args="$(var x) $(dirname) $(env E \'\')"/>'
    file = add_package("p", a=include + node) / "launch" / "a.launch"
    ((_, options),) = read(file, {}, {}).nodes.items()
    assert options["args"] == "$(find q)/launch $(find p)/launch $(optenv E)"


def test_parameters_are_values_trees_files_and_commands() -> None:
    text = """<node pkg="p" exec="t" name="n">
      <param name="a" value="1"/><param name="b" value="'1'"/>
      <param name="c"><param name="d" value="x"/><param name="e" value="true"/></param>
      <param name="f" value="1, 2" value-sep=","/><param name="g" value="$(env X 3)"/>
      <param name="h" value="4" type="str"/><param name="i" value="a: b: c"/>
      <param from="$(find-pkg-share q)/f.yaml" allow_substs="true"/>
      <param name="j" value="$(command 'xacro $(find-pkg-share q)/r.xacro')"/>
      <param name="k" value="1" if="false"/>
      <param name="m" value="$(command 'cat x' 'warn')"/></node>"""
    draft = convert(text)
    values = {"a": 1, "b": "1", "c": {"d": "x", "e": True}, "f": [1, 2], "g": "$(env X 3)"}
    assert draft.nodes["n"]["parameters"] == values | {"h": "4", "i": "a: b: c"}
    assert draft.nodes["n"]["parameter_files"] == [{"image_file": "$(find-pkg-share q)/f.yaml"}]
    commands = {"j": "xacro $(find-pkg-share q)/r.xacro", "m": "cat x"}
    assert draft.nodes["n"]["parameter_commands"] == commands
    assert draft.nodes["n"]["substitution_args"] is True
    assert "are not replaced (allow_substs)" in list_remarks(draft)


@pytest.mark.parametrize("name", ["", 'name="$(anon t)"'])
def test_a_node_without_a_fixed_name_is_anonymous(name: str) -> None:
    draft = convert(f'<node pkg="p" exec="t" {name}><remap from="~/a" to="b"/></node>')
    update = {"strategy": "Recreate"}
    assert draft.nodes == {"t": PROGRAM | {"anonymous": True, "update": update}}
    assert "it has no fixed name" in list_remarks(draft)
    assert "`remap` is left out: `~/a` needs the node's name" in list_remarks(draft)


def test_the_distribution_is_the_users() -> None:
    """No launch file names one; one of the other generation is refused."""
    Path("a.launch").write_text('<launch><node pkg="p" exec="t" name="n"/></launch>')
    draft = read(Path("a.launch"), {}, {}, "r:1", "jazzy")
    assert (draft.distro, list_remarks(draft)) == ("jazzy", "")
    draft = read(Path("a.launch"), {}, {}, "r:1")
    assert "pass --distro if it is not lyrical" in list_remarks(draft)
    with pytest.raises(UserError, match="is a launch file of ROS 2, and noetic is not"):
        read(Path("a.launch"), {}, {}, "r:1", "noetic")
    Path("b.launch").write_text('<launch><include file="c.launch"/></launch>')
    Path("c.launch").write_text(f"<launch>{NODE}</launch>")
    assert read(Path("b.launch"), {}, {}, "r:1", "noetic").distro == "noetic"


def test_components_belong_to_their_container() -> None:
    """They have what is set around it, but not its own parameters."""
    text = """<set_remap from="c" to="d"/><node_container pkg="p" exec="t" name="box">
      <param name="own" value="1"/>
      <composable_node pkg="p" plugin="p::A" name="a" namespace="h">
      <param name="x" value="1"/><param from="f.yaml"/><extra_arg name="y" value="true"/>
      <remap from="~/in" to="~/out"/></composable_node>
      <composable_node pkg="p" plugin="p::TwoB"/></node_container>"""
    draft = convert(text)
    assert draft.nodes["box"]["components"] == {
        "h/a": {
            "package": "p",
            "plugin": "p::A",
            "parameters": {"x": 1},
            "remappings": {"c": "d", "/h/a/in": "/h/a/out"},
            "extra_arguments": {"y": True},
        },
        "two_b": {"package": "p", "plugin": "p::TwoB", "remappings": {"c": "d"}},
    }
    assert "gets no parameter files" in list_remarks(draft)
    assert "it gets `two_b`" in list_remarks(draft)
    assert {remark.node for remark in draft.remarks} == {"box", None}


def test_the_time_of_a_simulation_is_a_remark() -> None:
    text = f'{NODE2}<set_use_sim_time value="true"/>'
    assert "set `parameters: { use_sim_time: true }` of the nodes" in list_remarks(convert(text))


def test_a_prefix_that_an_argument_leaves_empty_is_none() -> None:
    text = '<arg name="a" default=""/><node pkg="p" exec="t" name="n" launch-prefix="$(var a)"/>'
    assert list_remarks(convert(text)).count("\n") == 0


def test_the_text_is_that_of_the_file_whatever_its_first_line_says() -> None:
    first = '<?xml version="1.0" encoding="ISO-8859-1"?>'
    assert convert_one(f"{first}<launch>{NODE[:-2]} args='é'/></launch>")["args"] == "é"


def test_the_first_remapping_wins() -> None:
    """Those around a node come before its own, as in ros2 launch."""
    text = """<set_remap from="a" to="b"/><set_remap from="a" to="c"/>
      <node pkg="p" exec="t" name="n"><remap from="a" to="d"/><remap from="e" to="f"/></node>"""
    assert convert_one(text)["remappings"] == {"a": "b", "e": "f"}


def test_an_included_python_file_stays_a_launch_file_without_an_image() -> None:
    """Even if it is here; with an image it is evaluated (test_launch_python.py)."""
    add_package("nav2")
    Path("src/nav2/launch/b.launch.py").write_text("")
    text = """<push_ros_namespace namespace="g"/><set_env name="E" value="1"/>
      <include file="$(find-pkg-share nav2)/launch/b.launch.py">
      <arg name="x" value="True"/></include>"""
    Path("src/a.launch.xml").write_text(f"<launch>{text}<include file='b.py'/></launch>")
    draft = read(Path("src/a.launch.xml"), {}, {})
    launch = {"package": "nav2", "file": "b.launch.py", "args": {"x": "True"}}
    assert draft.nodes == {"b": {"launch": launch, "env": {"E": "1"}}}
    assert "it is in Python, and was not evaluated without --image" in list_remarks(draft)
    assert "nor the namespace g" in list_remarks(draft)
    assert "`include` is left out: it is in Python" in list_remarks(draft)


def test_without_a_package_the_file_names_the_robot() -> None:
    assert convert('<node pkg="p" exec="e"/>', "rover.launch.xml").name == "rover"


def test_python_is_refused_with_what_to_write() -> None:
    """A launch file in Python is never run or guessed."""
    file = add_package("rover") / "launch" / "go.launch.py"
    file.write_text("raise SystemExit")
    with pytest.raises(UserError, match="is a program, which is only run in your image") as error:
        read(file, {}, {})
    assert "launch: { package: rover, file: go.launch.py }" in (error.value.hint or "")


def test_pairs_need_a_sign(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["import", "launch", "a.launch", "--arg", "x"], "rigel") == 2
    assert '"x" is not NAME=VALUE' in capsys.readouterr().err


def test_a_package_and_a_file_are_found_as_roslaunch_finds_them() -> None:
    """Below this directory, or where --package says; several files of a name are a question."""
    node = '<node pkg="p" type="x" name="{}"/>'
    rover = add_package("rover", go=node.format("here"))
    assert run(["import", "launch", "rover", "go.launch", "--force"], "rigel") == 0
    assert "here:" in Path("Rigelfile").read_text()
    other = Path("elsewhere/launch/go.launch")
    other.parent.mkdir(parents=True)
    other.write_text(f"<launch>{node.format('there')}</launch>")
    words = ["import", "launch", "rover", "go.launch", "--force", "--package", "rover=elsewhere"]
    assert run(words, "rigel") == 0
    assert "there:" in Path("Rigelfile").read_text()
    (rover / "go.launch").write_text("")
    with pytest.raises(UserError, match=r'rover has 2 files "go\.launch"'):
        find_launch_file("rover", "go.launch", {})
    with pytest.raises(UserError, match=r'no package "rovr".*did you mean "rover"'):
        find_launch_file("rovr", "go.launch", {})

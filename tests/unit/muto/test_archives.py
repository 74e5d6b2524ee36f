"""`rigel muto convert ARCHIVE --to DIRECTORY` writes sources and what builds them, or nothing."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import os
import random
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.cli.main import run
from rigel_k8s.commands import rigelfiles
from rigel_k8s.commands.targets import job_of
from rigel_k8s.settings import Settings

from .packing import LAUNCH, WORKSPACE, make_member, make_stack, make_tar, pack, pack_zip
from .test_mutations import mutate
from .test_option import objects_of

IMAGE = "registry.example/eyes:1"
#: Where the image has the sources, as the Dockerfile job copies them.
IN_IMAGE = "/home/rigeluser/ros_workspace/src/sources"

Convert = Callable[..., tuple[int, str]]


@pytest.fixture
def convert(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Convert:
    """Convert a stack into the directory `out` of the working directory."""
    monkeypatch.chdir(tmp_path)

    def call(stack: Any, *words: str) -> tuple[int, str]:
        Path("stack.json").write_text(json.dumps(stack, indent=1))
        code = run(["muto", "convert", "stack.json", "--to", "out", *words], "rigel")
        return code, capsys.readouterr().err

    return call


def list_files(directory: Path) -> dict[str, str]:
    """Return the texts of the files below a directory, by their paths."""
    files = (path for path in directory.rglob("*") if path.is_file())
    return {str(path.relative_to(directory)): path.read_text() for path in files}


def read_node() -> Any:
    """Return the only node that the written Rigelfile deploys; it passes the check."""
    settings = Settings(rigelfile=Path("out/Rigelfile"))
    result = rigelfiles.check(settings)
    assert result.render_findings() == []
    (node,) = job_of(settings, None).options.nodes.values()
    return node


@pytest.mark.parametrize("packed", [pack(WORKSPACE), pack_zip(WORKSPACE)], ids=["tar", "zip"])
def test_an_archive_becomes_a_directory_that_builds_and_deploys(
    convert: Convert, packed: bytes
) -> None:
    """The sources as they are, and a Rigelfile with a job for each step."""
    assert convert(make_stack(packed), "--image", IMAGE) == (0, "")
    files = list_files(Path("out"))
    assert {
        p.removeprefix("sources/"): t for p, t in files.items() if p != "Rigelfile"
    } == WORKSPACE
    assert os.access("out/sources/src/left/scripts/look.py", os.X_OK)
    assert not os.access(f"out/sources/{LAUNCH}", os.X_OK)
    settings = Settings(rigelfile=Path("out/Rigelfile"))
    loaded = rigelfiles.load(settings)
    assert list(loaded.jobs) == ["dockerfile", "build", "deploy"]
    assert list(loaded.sequences) == ["deploy"]
    launch = read_node().launch
    assert (launch.file, launch.args) == (f"{IN_IMAGE}/{LAUNCH}", {"side": "left"})
    assert job_of(settings, None).options.image == IMAGE
    deployments = (o for o in objects_of(settings.rigelfile) if o["kind"] == "Deployment")
    assert [item["metadata"]["name"] for item in deployments] == ["two-eyes"]


def test_the_image_has_the_launch_file_where_the_node_looks_for_it(
    convert: Convert, capsys: pytest.CaptureFixture[str]
) -> None:
    """The Dockerfile that the written job makes copies the sources to that directory."""
    convert(make_stack(pack(WORKSPACE)))
    assert run(["-f", "out/Rigelfile", "run", "job", "dockerfile"], "rigel") == 0
    dockerfile = Path("out/sources/Dockerfile").read_text()
    assert f" . {IN_IMAGE}/\n" in dockerfile
    assert "colcon build" in dockerfile
    assert "src/left/package.xml" in dockerfile


def test_a_stack_without_sources_is_written_as_well(convert: Convert) -> None:
    """The directory has a Rigelfile and nothing else."""
    node = {"name": "talker", "pkg": "demo", "exec": "talker"}
    assert convert({"node": [node]})[0] == 0
    assert list(list_files(Path("out"))) == ["Rigelfile"]
    assert read_node().package == "demo"


def test_arguments_of_the_launch_file_can_be_given(convert: Convert) -> None:
    """They win over those of the archive."""
    assert convert(make_stack(pack(WORKSPACE)), "--arg", "side=right", "--arg", "n=2")[0] == 0
    assert read_node().launch.args == {"side": "right", "n": "2"}


def test_a_template_in_an_archive_is_text(convert: Convert) -> None:
    """Its names and values cannot read the environment of those who deploy it."""
    stack = make_stack(
        pack({"{{ vars.HOME }}.launch": "x"}),
        launch_file="{{ vars.HOME }}.launch",
        launch_args=[{"name": "a", "value": "{{ vars.HOME }}"}],
    )
    assert convert(stack)[0] == 0
    launch = read_node().launch
    assert launch.file == f"{IN_IMAGE}/{{{{ vars.HOME }}}}.launch"
    assert launch.args == {"a": "{{ vars.HOME }}"}


def test_an_archive_without_a_name_is_called_as_its_file(convert: Convert) -> None:
    stack = make_stack(pack(WORKSPACE))
    del stack["metadata"]["name"]
    assert convert(stack)[0] == 0
    (node,) = job_of(Settings(rigelfile=Path("out/Rigelfile")), None).options.nodes
    assert node == "stack"


def test_keys_of_muto_without_a_value_mean_nothing(convert: Convert) -> None:
    """Muto writes each key of its model."""
    node = {"name": "talker", "pkg": "demo", "exec": "talker"}
    assert convert({"node": [node], "on_start": "", "artifact": {}})[0] == 0


def test_a_script_is_started_by_bash(convert: Convert) -> None:
    """Muto starts a launch file that ends in .sh so, when it has stopped the one before."""
    stack = make_stack(pack({"ws/run.sh": "sleep 1"}), launch_file="run.sh", launch_args=[])
    assert convert(stack) == (0, "")
    node = read_node()
    assert (node.args, node.anonymous) == (["bash", f"{IN_IMAGE}/run.sh"], True)
    assert node.update.strategy == "Recreate"


def wrap_legacy(packed: bytes) -> dict[str, Any]:
    artifact = {
        "type": "archive",
        "filename": "eyes.tar.gz",
        "data": base64.b64encode(packed).decode(),
        "checksum": hashlib.sha256(packed).hexdigest(),
    }
    return {"name": "eyes", "artifact": artifact, "launch_description_source": LAUNCH}


def wrap_solution(packed: bytes) -> dict[str, Any]:
    data = base64.b64encode(gzip.compress(json.dumps(make_stack(packed)).encode())).decode()
    properties = {"type": "stack", "content-type": "stack/archive", "data": data}
    component = {"name": "eyes", "type": "muto-agent", "properties": properties}
    return {"metadata": {"name": "eyes"}, "spec": {"components": [component]}}


def wrap_thing(packed: bytes) -> dict[str, Any]:
    return {"thingId": "org:eyes", "features": {"stack": {"properties": make_stack(packed)}}}


@pytest.mark.parametrize("wrap", [wrap_legacy, wrap_solution, wrap_thing])
def test_an_archive_is_found_in_each_form(
    convert: Convert, wrap: Callable[[bytes], dict[str, Any]]
) -> None:
    """The older artifact, the only component of a Symphony solution, a Ditto thing."""
    assert convert(wrap(pack(WORKSPACE))) == (0, "")
    assert read_node().launch.file == f"{IN_IMAGE}/{LAUNCH}"


def test_both_checksums_that_muto_knows_are_accepted(convert: Convert) -> None:
    """That of the archive, and that of its base64, which Muto's script writes."""
    packed = pack(WORKSPACE)
    text = base64.b64encode(packed)
    for number, (algorithm, checksum) in enumerate(
        [
            ("sha256", hashlib.sha256(text).hexdigest()),
            ("SHA512", hashlib.sha512(packed).hexdigest().upper()),
            ("", hashlib.sha256(packed).hexdigest()),
            ("sha256", ""),
        ]
    ):
        stack = make_stack(packed, algorithm=algorithm, checksum=checksum)
        assert convert(stack, "--to", f"out{number}") == (0, "")


def test_layout_is_that_of_muto(convert: Convert) -> None:
    """A single top directory is left out unless `flatten` is false; `subdir` moves to the top."""
    inside = {f"ws/{path}": text for path, text in WORKSPACE.items()}
    cases: list[tuple[dict[str, str], dict[str, Any], str]] = [
        (inside, {}, LAUNCH),
        (inside, {"flatten": False}, f"ws/{LAUNCH}"),
        ({**inside, "README": ""}, {"subdir": "ws"}, LAUNCH),
        ({**inside, "README": ""}, {}, f"ws/{LAUNCH}"),
    ]
    for number, (files, properties, file) in enumerate(cases):
        stack = make_stack(pack(files), **properties)
        assert convert(stack, "--to", f"out{number}")[0] == 0
        assert Path(f"out{number}/sources/{file}").exists()
        assert f"file: {IN_IMAGE}/{file}\n" in Path(f"out{number}/Rigelfile").read_text()


LINKED = make_tar(
    make_member(LAUNCH, b"x"), make_member("b", type=tarfile.SYMTYPE, linkname="/etc")
)


def without(key: str) -> dict[str, Any]:
    stack: dict[str, Any] = make_stack(pack(WORKSPACE))
    del stack["launch"][key]
    return stack


@pytest.mark.parametrize(
    ("stack", "line", "message"),
    [
        (make_stack(b"no archive"), 7, "the archive cannot be read: "),
        (make_stack(LINKED), 7, 'the link "b" leads out of the archive, to "/etc" [bad-archive]'),
        (make_stack(pack(WORKSPACE), checksum="ab"), 10, "does not have this sha256 checksum, but"),
        (make_stack(pack(WORKSPACE), algorithm="crc"), 9, 'unknown algorithm "crc"'),
        (make_stack(pack(WORKSPACE), subdir="x"), 7, 'there is no directory "x" in the archive'),
        (make_stack(pack(WORKSPACE), launch_file=""), 6, "an archive needs a `launch_file`"),
        (make_stack(pack(WORKSPACE), launch_file="../a"), 11, '"../a" leads out of the archive'),
        (make_stack(pack(WORKSPACE), launch_file="a"), 11, 'the archive has no file "a"'),
        (
            make_stack(pack(WORKSPACE), launch_file="package.xml"),
            11,
            "but src/left/package.xml and src/right/package.xml: write one of them",
        ),
        (make_stack(pack(WORKSPACE), launch_args=["a"]), 14, "needs `name` and `default`"),
        (without("data"), 6, "an archive needs `data`"),
        (
            {**without("data"), "launch": {"url": "https://example/a.tar"}},
            7,
            "an archive is not fetched from a URL: download and unpack it",
        ),
        ({"name": "a", "on_start": "/opt/a.sh"}, 3, "deploy a node with `args: [bash, FILE]`"),
        ({"name": "a", "artifact": {}, "on_kill": "/a.sh"}, 4, "`on_kill` runs a file of a device"),
        ({"launch_description_source": "a.launch"}, 2, "deploy a node with `launch: {file: FILE}`"),
    ],
)
def test_nothing_is_written_if_anything_is_wrong(
    convert: Convert, stack: dict[str, Any], line: int, message: str
) -> None:
    """The error has its place in the stack."""
    code, errors = convert(stack)
    assert code == 2
    assert f"  stack.json:{line}:" in errors
    assert message in errors
    assert sorted(path.name for path in Path().iterdir()) == ["stack.json"]


def test_strict_refuses_what_is_not_carried_over(convert: Convert) -> None:
    """It is a warning otherwise, and stands in the Rigelfile."""
    stack = make_stack(pack(WORKSPACE), ros_args=[{"name": "a", "value": "b"}], colour="red")
    code, errors = convert(stack, "--strict")
    assert (code, "`ros_args` is not carried over" in errors) == (2, True)
    assert 'unknown key "colour" of an archive' in errors
    assert not Path("out").exists()
    assert convert(stack)[0] == 0
    assert ": `ros_args` is not carried over" in Path("out/Rigelfile").read_text()


def test_a_mutated_archive_is_written_or_refused(convert: Convert) -> None:
    """Never with a traceback; what is written passes `rigel check`."""
    stack, chance = make_stack(pack(WORKSPACE)), random.Random(3)
    written = 0
    for number in range(40):
        code, _ = convert(mutate(stack, chance), "--to", f"out{number}")
        assert code in (0, 2)
        assert Path(f"out{number}").exists() is (code == 0)
        if code == 0:
            written += 1
            result = rigelfiles.check(Settings(rigelfile=Path(f"out{number}/Rigelfile")))
            assert not result.errors, result.render_findings()
    assert written


def test_a_directory_that_is_there_is_kept(convert: Convert) -> None:
    """An empty one is filled; nothing is written through a link."""
    Path("out").mkdir()
    assert convert(make_stack(pack(WORKSPACE)))[0] == 0
    before = list_files(Path("out"))
    code, errors = convert(make_stack(pack({"a.launch": "x"}), launch_file="a.launch"))
    assert (code, "out already exists, and is not an empty directory" in errors) == (2, True)
    assert list_files(Path("out")) == before
    Path("empty").mkdir()
    Path("link").symlink_to("empty")
    assert convert(make_stack(pack(WORKSPACE)), "--to", "link")[0] == 2
    assert not any(Path("empty").iterdir())


def test_an_archive_in_a_job_names_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A job that deploys compiles nothing."""
    (tmp_path / "stack.json").write_text(json.dumps(make_stack(pack(WORKSPACE)), indent=1))
    deploy = {
        "plugin": "rigel_k8s.OrchestrationPlugin",
        "with": {"image": IMAGE, "muto": "stack.json"},
    }
    rigelfile = {"application": {"distro": "jazzy"}, "jobs": {"deploy": deploy}}
    (tmp_path / "Rigelfile").write_text(json.dumps(rigelfile))
    assert run(["-f", str(tmp_path / "Rigelfile"), "check"], "rigel") == 2
    found = capsys.readouterr()
    assert "`rigel muto convert STACK --to DIRECTORY` writes its sources" in found.out + found.err

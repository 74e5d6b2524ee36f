"""No code beside a Rigelfile runs before its directory is trusted; what is remembered."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.system.trust import distrust, is_trusted, read_trusted, state_file, trust

RIGELFILE = """\
application: {distro: noetic}
jobs:
  own: {plugin: mine.Job}
  package: {plugin: whole.inner.Job}
  entry: {plugin: offered}
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {deployment_name: demo, nodes: {talker: {image: "ros:1", command: [a]}}}
providers:
  shop: {provider: mine.Shop}
sequences:
  all: {stages: [{jobs: [own, deploy]}]}
"""
#: Writes down that it ran; then what a job type needs.
CODE = """\
import os, pathlib
with pathlib.Path(os.environ["FOREIGN"], "RAN").open("a") as file:
    file.write(__name__ + " ")
class Job:
    options = dict
    def check(self, options, application): return ()
    def run(self, options, job): job.report.line("the job ran")
"""
#: What commands import late: a file of this name must not be taken for it.
LIBRARIES = ("yaml", "jinja2", "urllib3", "rich", "difflib", "tarfile", "graphlib", "_strptime")


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A directory from elsewhere that tries to have its code run in each way."""
    place = tmp_path / "foreign"
    dist = place / "offered-1.dist-info"
    for directory in (place, dist, place / "whole"):
        directory.mkdir()
    (place / "Rigelfile").write_text(RIGELFILE)
    for name in ("mine", "whole/__init__", "whole/inner", *LIBRARIES):
        (place / f"{name}.py").write_text(CODE)
    (dist / "METADATA").write_text("Metadata-Version: 2.1\nName: offered\nVersion: 1\n")
    (dist / "entry_points.txt").write_text("[rigel_k8s.jobs]\noffered = mine:Job\n")
    return place


def rigel(
    directory: Path, *words: str, path: str = "", **more: str
) -> subprocess.CompletedProcess[str]:
    own = os.environ.get("PYTHONPATH", "")
    environ = {**os.environ, "PYTHONPATH": f"{path}{os.pathsep}{own}" if path else own, **more}
    environ["FOREIGN"] = str(directory)
    command = [sys.executable, "-m", "rigel_k8s", *words]
    return subprocess.run(command, cwd=directory, env=environ, capture_output=True, text=True)


COMPLETION = {"_RIGEL_K8S_COMPLETE": "bash_complete", "COMP_WORDS": "rigel-k8s render d"}


@pytest.mark.programs
@pytest.mark.parametrize(
    "words",
    [
        *(["check"], ["render"], ["render", "own"], ["status"]),
        *(["run", "job", "own"], ["run", "sequence", "all"], ["schema"]),
    ],
    ids=" ".join,
)
def test_no_command_runs_code_that_is_not_trusted(foreign: Path, words: list[str]) -> None:
    """Neither a class that the Rigelfile names, nor a file that looks like a library."""
    ended = rigel(foreign, *words, KUBECONFIG="/nonexistent")
    assert not (foreign / "RAN").exists(), (foreign / "RAN").read_text()
    assert "Traceback" not in ended.stderr


@pytest.mark.programs
def test_completion_runs_no_code_that_is_not_trusted(foreign: Path) -> None:
    """A shell asks at each press of the Tab key."""
    ended = rigel(foreign, **COMPLETION, COMP_CWORD="2")
    assert "deploy" in ended.stdout
    assert not (foreign / "RAN").exists()


@pytest.mark.programs
def test_the_working_directory_on_the_search_path_is_not_trusted_either(foreign: Path) -> None:
    """An empty part of $PYTHONPATH, a usual slip, puts it there."""
    for library in LIBRARIES:
        (foreign / f"{library}.py").unlink()
    ended = rigel(foreign, "check", path=str(foreign))
    assert not (foreign / "RAN").exists()
    assert f"mine.Job would run the code in {foreign}/mine.py" in ended.stdout


@pytest.mark.programs
def test_the_error_says_what_would_run_and_what_to_type(foreign: Path) -> None:
    """For a job and for a provider; what the hint says makes the command work."""
    told = rigel(foreign, "check").stdout
    assert f"mine.Job would run the code in {foreign}/mine.py, and {foreign} is not trusted" in told
    assert f"whole.inner.Job would run the code in {foreign}/whole/__init__.py" in told
    assert "mine.Shop would run" in told
    assert f"rigel trust {foreign}" in told
    assert told.count("[untrusted]") == 3
    assert 'unknown job type "offered"' in told
    assert rigel(foreign, "trust", str(foreign)).returncode == 0
    ended = rigel(foreign, "run", "job", "package")
    assert "mine.Shop" in ended.stderr
    assert (foreign / "RAN").read_text() == "whole whole.inner mine "


@pytest.mark.programs
def test_trust_as_an_option_of_a_command(foreign: Path) -> None:
    """--trust is remembered as `rigel trust` is."""
    (foreign / "Rigelfile").write_text(RIGELFILE.replace("  shop: {provider: mine.Shop}", ""))
    assert "the job ran" in rigel(foreign, "--trust", "run", "job", "own").stderr
    assert "the job ran" in rigel(foreign, "run", "job", "own").stderr


@pytest.mark.programs
def test_list_and_remove(tmp_path: Path) -> None:
    """The words of the command say what changed."""
    assert rigel(tmp_path, "trust").stdout == f"{tmp_path} is trusted now\n"
    assert rigel(tmp_path, "trust", ".").stdout == f"{tmp_path} was trusted already\n"
    assert rigel(tmp_path, "trust", "--list").stdout == f"{tmp_path}\n"
    assert rigel(tmp_path, "trust", "--remove").stdout == f"{tmp_path} is no longer trusted\n"
    assert rigel(tmp_path, "trust", "--list").stdout == ""


def test_trust_is_of_one_real_directory(tmp_path: Path) -> None:
    """A link to it is the same directory, those in it and above it are not."""
    place = tmp_path / "place"
    (place / "inner").mkdir(parents=True)
    (tmp_path / "link").symlink_to(place)
    assert trust(tmp_path / "link")
    assert is_trusted(place)
    assert is_trusted(tmp_path / "link")
    assert not is_trusted(place / "inner")
    assert not is_trusted(tmp_path)
    assert not trust(place)
    assert distrust(place)
    assert not is_trusted(place)


def test_trust_ends_when_the_directory_belongs_to_someone_else(tmp_path: Path) -> None:
    """Somebody else made a directory of the same name, in /tmp say."""
    trust(tmp_path)
    state_file().write_text(json.dumps({"directories": {str(tmp_path): os.getuid() + 1}}))
    assert not is_trusted(tmp_path)


def test_what_everyone_may_write_cannot_be_trusted(tmp_path: Path) -> None:
    """In such a directory anyone can put a module."""
    tmp_path.chmod(0o777)
    with pytest.raises(UserError, match="every user of this machine may write into it"):
        trust(tmp_path)


def test_only_the_user_reads_and_writes_what_is_remembered(tmp_path: Path) -> None:
    """Mode 0600, in a directory of mode 0700, and no part of a write is ever seen."""
    trust(tmp_path)
    assert stat.S_IMODE(state_file().stat().st_mode) == 0o600
    assert stat.S_IMODE(state_file().parent.stat().st_mode) == 0o700
    assert sorted(file.name for file in state_file().parent.iterdir()) == ["trusted.json"]


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "null", '{"directories": 5}', "\x00", '{"a": ' * 3000]
)
def test_a_damaged_file_trusts_nothing(tmp_path: Path, content: str) -> None:
    """It is an error with its place, and no traceback."""
    trust(tmp_path)
    state_file().write_text(content)
    with pytest.raises(RigelK8sError, match=r"trusted\.json is damaged"):
        is_trusted(tmp_path)


def test_a_file_that_others_may_write_trusts_nothing(tmp_path: Path) -> None:
    """They could have written anything."""
    trust(tmp_path)
    state_file().chmod(0o620)
    with pytest.raises(RigelK8sError, match="other users may write it"):
        read_trusted()


def test_a_relative_place_for_state_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a Rigelfile's directory could bring its own trust."""
    monkeypatch.setenv("XDG_STATE_HOME", "state")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_file() == tmp_path / ".local" / "state" / "rigel-k8s" / "trusted.json"

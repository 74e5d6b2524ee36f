"""The entry: help without imports, unknown commands, errors and exit codes."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import click
import pytest

from rigel_k8s import installed
from rigel_k8s.cli import main
from rigel_k8s.commands import run as runs
from rigel_k8s.errors import ClusterError, Interrupted, RigelK8sError, UserError

HEAVY = (
    "attrs",
    "yaml",
    "jinja2",
    "rich",
    "urllib3",
    "kubernetes",
    "rigel_k8s.rigelfile",
    "rigel_k8s.kube",
)


@pytest.mark.programs
def test_help_imports_nothing_heavy() -> None:
    """`rigel --help` costs little more than click: no YAML, no HTTP, no attrs."""
    code = (
        "import sys\n"
        "from rigel_k8s.cli.main import run\n"
        "assert run(['--help'], 'rigel') == 0\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize("name", main.list_all_commands())
def test_every_command_of_the_table_is_there_and_helps(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table of help names commands that exist, and each has a help of its own."""
    assert main.run([name, "--help"], "rigel") == 0
    assert "Usage: rigel" in capsys.readouterr().out


def test_what_a_package_adds_is_where_it_says() -> None:
    """After the command that it names, else at the end."""
    names = list(main.list_all_commands())
    first = names.index("status")
    assert names[first : first + 7] == ["status", "graph", "expect", "logs", "ui", "topic", "param"]
    assert names[-2:] == ["import", "muto"]


def test_a_command_does_not_need_those_of_other_packages(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that cannot be imported is named where it is called, and in the list of all."""
    broken = EntryPoint("greet", "no_such_package:COMMAND", "rigel_k8s.commands")
    entries = (*installed.list_entries("rigel_k8s.commands"), broken)
    monkeypatch.setattr(installed, "list_entries", lambda group: entries)
    assert main.run(["ui", "--help"], "rigel") == 0
    assert main.run(["greet"], "rigel") == 2
    assert "cannot import command greet" in capsys.readouterr().err


def test_an_unknown_command_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    """A misspelt command is a usage error (2) that says what was probably meant."""
    assert main.run(["staus"], "rigel") == 2
    assert capsys.readouterr().err == (
        'error: unknown command "staus", did you mean "status"?\n'
        "hint: `rigel --help` shows how it is used\n"
    )


@pytest.mark.parametrize(
    ("word", "meant"),
    [("deploy", "run"), ("up", "run"), ("ps", "status"), ("stop", "down"), ("hz", "topic hz")],
)
def test_a_word_of_another_tool_names_the_command(
    word: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """`stop` is no mistake for `top`."""
    assert main.run([word], "rigel") == 2
    assert f'unknown command "{word}", did you mean "{meant}"?' in capsys.readouterr().err


def test_every_other_word_leads_to_a_command() -> None:
    """And none of them is a command itself."""
    assert {word.split()[0] for word in main.OTHER_WORDS.values()} <= set(main.list_all_commands())
    assert not set(main.OTHER_WORDS) & set(main.list_all_commands())


def test_a_usage_error_looks_like_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    """What, and where its help is."""
    assert main.run(["list", "--nope"], "rigel") == 2
    error, hint = capsys.readouterr().err.splitlines()
    assert error.lower().startswith("error: no such option")
    assert hint == "hint: `rigel list --help` shows how it is used"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UserError("bad flag", hint="write a good one"), 2),
        (ClusterError("refused", details=["Forbidden"]), 1),
        (Interrupted("stopped"), 130),
        (RigelK8sError("broke"), 1),
    ],
)
def test_errors_are_told_without_a_traceback(
    error: RigelK8sError,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """What, what helps, what next; the exit code says whose fault it is."""

    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(main.cli, "main", fail)
    assert main.run(["status"], "rigel") == code
    told = capsys.readouterr().err
    assert f"error: {error.message}" in told
    assert "Traceback" not in told
    assert all(detail in told for detail in error.details)
    assert error.hint is None or f"hint: {error.hint}" in told


def test_a_bug_keeps_its_traceback_and_asks_to_be_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Anything that is not our error is a bug; it is told as one."""

    def fail(**_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(main.cli, "main", fail)
    assert main.run(["status"], "rigel") == 1
    told = capsys.readouterr().err
    assert "ZeroDivisionError" in told
    assert "This is a bug in rigel-k8s" in told.splitlines()[-1]


def test_verbose_tells_where_an_error_came_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """-v shows an error's traceback, which users are spared otherwise; they get a way out."""
    file = ["-f", str(tmp_path / "Rigelfile")]
    assert main.run([*file, "check"], "rigel") == 2
    told = capsys.readouterr().err
    assert "rigel init" in told
    assert "Traceback" not in told
    assert main.run([*file, "-v", "check"], "rigel") == 2
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.programs
def test_rigels_own_commands_are_rigels_where_it_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Our `rigel run` hands over to Rigel; `rigel-k8s run` and `python -m rigel_k8s` never do."""
    package = tmp_path / "rigel"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "orchestrator.py").touch()
    (package / "main.py").write_text("def main(): print('it is Rigel')\n")
    code = (
        "import sys; sys.argv = {argv!r}; from rigel_k8s.cli.main import main; main(name={name!r})"
    )

    def output(argv: list[str], name: str | None) -> str:
        done = subprocess.run(
            [sys.executable, "-c", code.format(argv=argv, name=name)],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        )
        return done.stdout + done.stderr

    assert output(["/bin/rigel", "run", "job", "x"], None) == "it is Rigel\n"
    assert "Rigelfile does not exist" in output(["/bin/rigel-k8s", "run", "job", "x"], None)
    assert "Rigelfile does not exist" in output(["/bin/rigel", "run", "job", "x"], "rigel-k8s")


def test_ctrl_c_is_130(monkeypatch: pytest.MonkeyPatch) -> None:
    """As shells expect of an interrupted command."""

    def fail(**_: object) -> None:
        raise click.Abort

    monkeypatch.setattr(main.cli, "main", fail)
    assert main.run(["status"], "rigel") == 130


def test_the_namespace_may_follow_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where people write it; also for `run`."""
    seen: list[str | None] = []
    monkeypatch.setattr(runs, "run", lambda _, __, settings, ___: seen.append(settings.namespace))
    assert main.run(["run", "deploy", "-n", "robots"], "rigel") == 0
    assert seen == ["robots"]


@pytest.mark.programs
def test_a_closed_pipe_is_silent() -> None:
    """`rigel ... | head -1` ends without a word on standard error."""
    line = f"{sys.executable} -m rigel_k8s schema | head -1"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout.strip() == "{"


@pytest.mark.programs
def test_a_pipe_that_was_closed_before_is_silent_too() -> None:
    """Little output is written only at the end, when nobody reads any more."""
    line = f"{{ sleep 0.2; {sys.executable} -m rigel_k8s version; }} | true"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
    assert done.stderr == ""


@pytest.mark.programs
def test_the_program_ends_with_all_that_was_printed_and_cleaned_up(tmp_path: Path) -> None:
    """It does not free its memory, but flushes its streams and calls what waits for its end."""
    code = (
        "import atexit, sys; atexit.register(print, 'cleaned up'); sys.argv = ['rigel', {!r}];"
        "from rigel_k8s.cli.main import main; main()"
    )
    out = tmp_path / "out"
    for word, exit_code in (("schema", 0), ("statsu", 2)):
        with out.open("w") as file:
            command = [sys.executable, "-c", code.format(word)]
            done = subprocess.run(command, stdout=file, stderr=subprocess.PIPE, text=True)
        assert done.returncode == exit_code
        assert out.read_text().endswith("cleaned up\n")
        assert (out.stat().st_size > 10_000) == (word == "schema")
        assert ("unknown command" in done.stderr) == (word == "statsu")


@pytest.mark.programs
@pytest.mark.parametrize(
    ("line", "code", "error"),
    [
        ("version >&-", 1, "error: standard output is closed; to discard it, use > /dev/null\n"),
        ("version > /dev/full", 1, "error: cannot write the output: No space left on device\n"),
        ("schema > /dev/full", 1, "error: cannot write the output: No space left on device\n"),
        ("-f /nowhere/Rigelfile check 2>&-", 2, ""),
        ("explain mtu <&- > /dev/null", 0, ""),
    ],
)
def test_closed_and_full_streams_are_no_bugs(line: str, code: int, error: str) -> None:
    """One line at most, and the exit code that the command has otherwise."""
    command = f"{sys.executable} -m rigel_k8s {line}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (code, error)

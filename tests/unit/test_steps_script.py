"""What `./run` and the demos show of a long step, in a terminal and elsewhere."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.support.terminal import Terminal, open_terminal
from tests.support.until import until

pytestmark = pytest.mark.programs

SCRIPT = Path(__file__).parents[2] / "tools/steps.sh"
#: A command with more words than a terminal is wide; it goes on when it is allowed to.
COMMAND = """set -euo pipefail
. {script}
command() {{
  for number in 1 2 3; do echo "Unpacking package $number of $(printf '%0120d' 0)"; done
  while [ ! -e {go} ]; do sleep 0.02; done
  return {code}
}}
step "Installing Debian packages: podman" command
echo next
"""


def bash(text: str, directory: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a script without a terminal; its logs are in the directory."""
    return subprocess.run(
        ["bash", "-c", text],
        capture_output=True,
        text=True,
        env={**os.environ, "TMPDIR": str(directory), **variables},
        timeout=60,
        check=False,
    )


def script(directory: Path, *, code: int = 0) -> str:
    return COMMAND.format(script=SCRIPT, go=directory / "go", code=code)


def start(directory: Path, *, code: int = 0, **variables: str) -> Terminal:
    """Run the script in a terminal, as a user's shell starts it."""
    environment = {"TMPDIR": str(directory), "CI": "", "NO_COLOR": "", **variables}
    return open_terminal(["bash", "-c", script(directory, code=code)], environment)


def test_without_a_terminal_a_step_is_one_line(tmp_path: Path) -> None:
    """A log of CI has no output of apt, and nothing is left of it."""
    (tmp_path / "go").touch()
    done = bash(script(tmp_path), tmp_path)
    assert done.returncode == 0
    assert done.stderr == "==> Installing Debian packages: podman\n"
    assert done.stdout == "next\n"
    assert not list(tmp_path.glob("*.log"))


def test_a_failure_shows_the_output_and_keeps_it(tmp_path: Path) -> None:
    """What failed can be read where CI's log is all that is left, and in the file."""
    (tmp_path / "go").touch()
    done = bash(script(tmp_path, code=3), tmp_path)
    (log,) = tmp_path.glob("*.log")
    assert done.returncode == 3
    assert done.stderr.count("Unpacking package") == 3
    assert log.read_text().count("Unpacking package") == 3
    assert done.stderr.splitlines()[-1].endswith(f"exit code 3; all its output is in {log}")
    assert done.stdout == "", "the script ends with it"


def test_in_a_terminal_one_line_moves_and_one_stays(tmp_path: Path) -> None:
    """The last words are beside the title; the line is never wider than the terminal."""
    terminal = start(tmp_path)
    terminal.until("Unpacking package 3")
    assert "Installing Debian packages: podman" in terminal.text
    (tmp_path / "go").touch()
    assert terminal.end() == 0
    shown = [line for line in terminal.screen() if line]
    assert len(shown) == 2, shown
    assert shown[0].startswith("==> Installing Debian packages: podman (")
    assert shown[1] == "next"


def test_a_silent_command_moves_too(tmp_path: Path) -> None:
    """Its line shows that time passes."""
    text = f"set -euo pipefail; . {SCRIPT}; step Waiting sleep 60"
    terminal = open_terminal(["bash", "-c", text], {"TMPDIR": str(tmp_path), "CI": ""})
    terminal.until("1 s  Waiting")
    terminal.press("\x03")
    assert terminal.end() == -signal.SIGINT


@pytest.mark.parametrize("variable", [{"TERM": "dumb"}, {"NO_COLOR": "1"}, {"CI": "true"}])
def test_no_line_moves_where_it_cannot(variable: dict[str, str], tmp_path: Path) -> None:
    """Such a terminal keeps all that is written to it."""
    (tmp_path / "go").touch()
    terminal = start(tmp_path, **variable)
    assert terminal.end() == 0
    assert "\x1b" not in terminal.text
    assert terminal.text.split("\r\n") == ["==> Installing Debian packages: podman", "next", ""]


def test_ctrl_c_ends_it_and_leaves_nothing_behind(tmp_path: Path) -> None:
    """Neither the line that moves nor what moves it."""
    terminal = start(tmp_path)
    terminal.until("Unpacking package 3")
    terminal.press("\x03")
    assert terminal.end() == -signal.SIGINT
    assert [line for line in terminal.screen() if line] in ([], ["^C"])
    assert not list(tmp_path.glob("*.log"))


#: What stands for Debian's programs and for the user's number.
PROGRAMS = {
    "apt-get": """
echo "$*" >>{directory}/calls
echo "Reading package lists..."
[ "$1" = update ] || exit {code}
""",
    "sudo": """
echo "sudo $1" >>{directory}/calls
[ "$1" != -E ] || shift
exec "$@"
""",
    "id": "echo {user}",
}


def apt(directory: Path, *, code: int = 0, user: int = 0) -> subprocess.CompletedProcess[str]:
    """Ask for two packages, one of which is installed, where apt is a program that takes notes."""
    programs = directory / "bin"
    programs.mkdir()
    for name, text in PROGRAMS.items():
        filled = text.format(directory=directory, code=code, user=user)
        (programs / name).write_text(f"#!/bin/sh\n{filled}")
        (programs / name).chmod(0o755)
    text = f". {SCRIPT}; set -e; packages /bin/sh dash /nonexistent podman; echo next"
    return bash(text, directory, PATH=f"{programs}:{os.environ['PATH']}")


@pytest.mark.parametrize(
    ("user", "sudo"), [(0, []), (1000, ["sudo true", "sudo -E", "sudo -E"])], ids=["root", "sudo"]
)
def test_only_what_is_missing_is_installed(user: int, sudo: list[str], tmp_path: Path) -> None:
    """As root or by sudo, which asks for its password first, in one line that names it."""
    done = apt(tmp_path, user=user)
    assert (done.returncode, done.stdout) == (0, "next\n"), done.stderr
    assert done.stderr == "==> Installing Debian packages: podman\n"
    calls = (tmp_path / "calls").read_text().splitlines()
    assert [call for call in calls if call.startswith("sudo")] == sudo
    update, install = (call for call in calls if not call.startswith("sudo"))
    assert update.split()[0] == "update"
    assert " install " in install
    assert install.endswith(" podman")


def test_what_apt_refuses_ends_the_script(tmp_path: Path) -> None:
    """Its exit code is that of the script."""
    done = apt(tmp_path, code=100)
    assert (done.returncode, done.stdout) == (100, "")
    assert "Reading package lists..." in done.stderr


def test_without_root_and_sudo_it_says_what_to_do(tmp_path: Path) -> None:
    """Before it begins, with the packages that are missing."""
    (tmp_path / "id").write_text("#!/bin/bash\necho 1000\n")
    (tmp_path / "id").chmod(0o755)
    (tmp_path / "bash").symlink_to("/bin/bash")
    done = bash(f". {SCRIPT}; packages /nonexistent podman", tmp_path, PATH=str(tmp_path))
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "error: cannot install podman: sudo is not installed",
        "hint: run this as root",
    ]


def test_a_step_ends_what_moves_when_its_shell_is_killed(tmp_path: Path) -> None:
    """A terminal that was closed has nothing of ours running."""
    terminal = start(tmp_path)
    terminal.until("Unpacking package 3")
    os.killpg(terminal.process, signal.SIGHUP)
    assert terminal.end() == -signal.SIGHUP
    until(lambda: not _in_group(terminal.process), "end of the group", every=0.05)


def _in_group(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True

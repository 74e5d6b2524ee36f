"""What is in a terminal while a command runs, and after it: widths, colors, rows, Ctrl-C."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rigel_k8s.cli import width as colors
from tests.support.terminal import Terminal, open_terminal

pytestmark = pytest.mark.programs

SOURCES = Path(colors.__file__).parents[1]
#: A status of DDS nodes: the widest table there is.
TABLE = """
from rigel_k8s.cli.status import OPTIONAL
from rigel_k8s.cli.tables import table
heads = ["NODE", "ROS NAME", "READY", "POD", "ON", "INTERFACE", "ADDRESS", "DISCOVERED", "RESTARTS"]
heads += ["AGE", "IMAGE"]
row = ["talker", "/robot/front/talker", "1/1", "talker-7d8f9c6b5-x2x4z", "node2", "net1"]
row += ["10.244.1.13", "2/2", "0", "73s", "10.0.0.2:5000/ros:noetic@sha256:f3d1c0a"]
print(table(heads, [row], OPTIONAL))
print(table(["REVISION", "DESCRIPTION"], [["3", "job deploy of demo " + "x" * 100 + " the end"]]))
"""
WHOLE = "OPTIONAL, (), ('NODE', 'POD'))"
#: Waits as commands do, with more rows than words fit into, until it is interrupted.
WAITING = """
import sys
from rigel_k8s.cli.reports import reporter
from rigel_k8s.commands.interruption import interruptible
print("before", file=sys.stderr)
with interruptible() as cancel, reporter() as report:
    report.line("a line that stays")
    report.progress("Deployment listener", "1/1 ready", done=True)
    report.progress("Deployment exporter", "0/1 ready")
    report.progress("Deployment exporter", "", done=True)
    for number in range(40):
        report.progress(f"Deployment talker-{number}", "0/1 ready: " + "a long reason " * 20)
    cancel.wait(60)
print("interrupted", file=sys.stderr)
sys.exit(130)
"""


def python(text: str, columns: int, **environment: str) -> Terminal:
    """Run a program in a terminal."""
    environment = {"NO_COLOR": "", "FORCE_COLOR": "", **environment}
    return open_terminal([sys.executable, "-c", text], environment, columns=columns)


@pytest.mark.parametrize("columns", [64, 80, 120, 160])
def test_names_that_are_typed_are_whole_or_left_out(columns: int) -> None:
    """That of a node is always there."""
    text = TABLE.replace('"talker"', '"the-long-name-of-a-talker"').replace("OPTIONAL)", WHOLE)
    terminal = python(text, columns)
    assert terminal.end() == 0
    heads, row, *_ = terminal.text.splitlines()
    assert row.startswith("the-long-name-of-a-talker ")
    assert ("talker-7d8f9c6b5-x2x4z" in row) == ("POD" in heads)
    assert len(row) <= columns


@pytest.mark.parametrize("columns", [64, 80, 120, 160])
def test_a_row_of_a_table_is_a_line_of_the_terminal(columns: int) -> None:
    """Its columns stay below their heads."""
    terminal = python(TABLE, columns)
    assert terminal.end() == 0
    lines = terminal.text.splitlines()
    assert len(lines) == 4
    assert max(map(len, lines)) <= columns
    assert lines[1].index("2/2") == lines[0].index("DISCOVERED")
    assert "talk" in lines[1]
    assert "2x4z" in lines[1], "the end of a name is what differs"
    assert lines[3].startswith("3         job deploy")
    assert lines[3].endswith("the end")


def test_images_are_left_out_before_names_are_cut() -> None:
    """A pod's name is copied into the next command; an image's rarely."""
    code = """
from rigel_k8s.cli.status import OPTIONAL
from rigel_k8s.cli.tables import table
heads = ["NODE", "ROS NAME", "READY", "POD", "ON", "RESTARTS", "AGE", "IMAGE"]
pod = "driver-7d8f9c6b5-x2x4z"
row = ["driver", "/bot/driver", "1/1", pod, "node2", "0", "73s", "10.0.0.2:5000/ros@sha256:f3d1c0a"]
print(table(heads, [row], OPTIONAL))
"""
    terminal = python(code, 80)
    assert terminal.end() == 0
    assert "IMAGE" not in terminal.text
    assert "/bot/driver  1/1    driver-7d8f9c6b5-x2x4z" in terminal.text


def test_a_wide_terminal_and_a_pipe_have_everything() -> None:
    """Scripts cut columns; nothing is left out where there is room."""
    terminal = python(TABLE, 200)
    assert terminal.end() == 0
    done = subprocess.run(
        [sys.executable, "-c", TABLE], capture_output=True, text=True, check=True, timeout=60
    )
    assert terminal.text.replace("\r", "") == done.stdout
    assert "…" not in done.stdout
    assert "10.0.0.2:5000/ros:noetic@sha256:f3d1c0a" in done.stdout


@pytest.mark.parametrize("group", ["cluster", "image", "muto", "network", "observe"])
def test_help_of_a_group_is_complete(group: str) -> None:
    """A sentence that does not fit goes on in the next line."""
    terminal = open_terminal([sys.executable, "-m", "rigel_k8s", group, "--help"], {})
    assert terminal.end() == 0
    assert "Commands:" in terminal.text
    assert "..." not in terminal.text.partition("Commands:")[2]


WORDS = """
import sys
from rigel_k8s.cli.main import show
from rigel_k8s.errors import UserError
address = "https://registry.example:5000/" + "x" * 60
show(UserError(f"the pod ros-master-5cb9b998cb-92fsp cannot be asked: {address} is unreachable"))
"""


@pytest.mark.parametrize("columns", [30, 40, 80])
def test_an_error_is_wrapped_between_words(columns: int) -> None:
    """An address stays whole; without a terminal the message is one line."""
    terminal = python(WORDS, columns)
    assert terminal.end() == 0
    text = re.sub("\x1b\\[[0-9;]*m", "", terminal.text).replace("\r", "")
    assert all(len(line) <= columns or " " not in line for line in text.splitlines())
    assert text.count("\n") > 1
    done = subprocess.run(
        [sys.executable, "-c", WORDS], capture_output=True, text=True, check=True, timeout=60
    )
    assert text.replace("\n", " ").split() == done.stderr.split()
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("columns", "rows"), [(40, 40), (40, 3), (80, 3), (160, 40)])
def test_progress_leaves_only_lines_that_stay(columns: int, rows: int) -> None:
    """Also after Ctrl-C, in a narrow terminal, with more rows than it has."""
    terminal = python(WAITING.replace("range(40)", f"range({rows})"), columns)
    terminal.until("talker-2")
    if rows == 3:
        terminal.press("\x03")
    else:  # the terminal's ^C could come in the middle of so many rows
        os.kill(terminal.process, signal.SIGINT)
    assert terminal.end() == 130
    assert terminal.text.rfind("\x1b[?25h") > terminal.text.rfind("\x1b[?25l"), "no cursor"
    shown = [line.replace("^C", "") for line in terminal.screen()]
    kept = ["before", "a line that stays", "✓ Deployment listener: 1/1 ready", "interrupted"]
    assert [line for line in shown if line] == kept


@pytest.mark.parametrize("term", ["dumb", ""])
def test_a_dumb_terminal_gets_lines(term: str) -> None:
    """It can only append, so each change is a line, without colors."""
    terminal = python(WAITING, 80, TERM=term)
    terminal.until("talker-39")
    terminal.press("\x03")
    assert terminal.end() == 130
    assert "\x1b" not in terminal.text
    assert "  Deployment talker-0: 0/1 ready" in terminal.text


@pytest.mark.parametrize(
    ("variables", "colored"),
    [
        ({}, False),
        ({"FORCE_COLOR": "1"}, True),
        ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, False),
        ({"FORCE_COLOR": "1", "TERM": "dumb"}, True),
    ],
)
def test_force_color_colors_a_pipe(
    variables: dict[str, str],
    colored: bool,  # noqa: FBT001 - pytest passes it by name
    tmp_path: Path,
) -> None:
    """For logs that show colors; NO_COLOR is stronger."""
    done = subprocess.run(
        [sys.executable, "-m", "rigel_k8s", "check"],
        cwd=tmp_path,
        env={**os.environ, "NO_COLOR": "", "FORCE_COLOR": "", **variables},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "error: " in done.stderr
    assert ("\x1b" in done.stderr) == colored


@pytest.mark.parametrize(("term", "colored"), [("xterm", True), ("dumb", False)])
def test_a_terminal_has_colors_if_it_can(
    term: str,
    colored: bool,  # noqa: FBT001 - pytest passes it by name
    tmp_path: Path,
) -> None:
    """Errors of Emacs' shell are plain text."""
    terminal = open_terminal(
        [sys.executable, "-m", "rigel_k8s", "check"],
        {"TERM": term, "NO_COLOR": "", "FORCE_COLOR": ""},
        directory=tmp_path,
    )
    assert terminal.end() == 2
    assert ("\x1b" in terminal.text) == colored


def test_colors_are_readable_on_white_and_on_black() -> None:
    """Yellow and what is bright vanish on white, blue on black; nodes of logs take turns."""
    text = "".join(file.read_text("utf-8") for file in sorted((SOURCES / "cli").glob("*.py")))
    used = set(re.findall(r'(?:fg|style|column\(style)=f?"([^"]*)"', text))
    used |= {colors.WARNING, *colors.NAMES, *re.findall(r'"[-+@]": "(\w+)"', text)}
    assert used <= {"red", "green", "cyan", "magenta", "dim", "bold {WARNING}"}
    styles = [tuple(colors.name_style(number).items()) for number in range(6)]
    assert len(set(styles)) == 6


def test_interrupted_is_a_line_of_its_own(tmp_path: Path) -> None:
    """Not the end of the ^C that the terminal writes."""
    (tmp_path / "Rigelfile").write_text("jobs: {}\n")
    command = "import sys, time; from rigel_k8s.cli import main; main.cli.main = lambda **_: wait()"
    command += "\ndef wait(): print('waits', flush=True); time.sleep(60)"
    command += "\nsys.exit(main.run([], 'rigel'))"
    terminal = python(command, 80)
    terminal.until("waits\r\n")
    terminal.until_asleep()
    terminal.press("\x03")
    assert terminal.end() == 130
    assert terminal.screen()[:3] == ["waits", "^C", "interrupted"]


INTERRUPTED = """
import sys
from rigel_k8s.cli import main
from rigel_k8s.cli.reports import reporter
from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.errors import Interrupted
def work(**_):
    with reporter(plain="plain" in sys.argv) as report, interruptible() as cancel:
        report.line("waits")
        while not cancel.wait(0.2):
            pass  # a signal just before a wait is seen at its end
        if "stops" in sys.argv:
            report.warn("stops")
        raise Interrupted("interrupted while it waited")
main.cli.main = work
main.main([], name="rigel")
"""


@pytest.mark.parametrize("words", [(), ("stops",), ("plain",), ("plain", "stops")])
def test_what_follows_ctrl_c_begins_a_line(words: tuple[str, ...]) -> None:
    """Live rows erase the ^C of the terminal; without them it ends its line."""
    terminal = open_terminal(
        [sys.executable, "-c", INTERRUPTED, *words], {"NO_COLOR": "1", "FORCE_COLOR": ""}
    )
    terminal.until("waits\r\n")
    terminal.press("\x03")
    assert terminal.end() == 130
    echo = ["^C"] if "plain" in words else []
    warning = ["warning: stops"] if "stops" in words else []
    error = "error: interrupted while it waited"
    shown = terminal.screen()
    assert shown == ["waits", *echo, *warning, error, ""]


@pytest.mark.parametrize(
    ("keys", "code", "shown"),
    [
        ("\x03", 130, ["^C", "interrupted"]),
        ("\x04", 130, ["", "interrupted"]),
        ("n\r", 1, ["n", "nothing was deleted"]),
        ("\r", 1, ["", "nothing was deleted"]),
    ],
)
def test_a_question_that_is_not_answered_with_yes(
    keys: str, code: int, shown: list[str], tmp_path: Path
) -> None:
    """Ctrl-C, Ctrl-D and no are one line each, and nothing is deleted."""
    words = [sys.executable, "-m", "rigel_k8s", "down", "--sequence", "s", "--volumes"]
    terminal = open_terminal(words, {}, directory=tmp_path)
    terminal.until("[y/N]: ")
    terminal.until_asleep()
    terminal.press(keys)
    assert terminal.end() == code
    question, rest = terminal.screen()[0], terminal.screen()[1:]
    assert [question.partition("[y/N]:")[2].strip(), *rest] == [*shown, ""]

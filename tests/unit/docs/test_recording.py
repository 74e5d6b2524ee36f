"""The recorded run of the README (tools/recording): what a terminal shows, as a picture."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from tools.recording.commands import COLUMNS, Run, run
from tools.recording.drawing import draw

ROOT = Path(__file__).parents[3]
RUNS = [
    Run("rigel check", "one <two>\n\x1b[31mred\x1b[0m \x1b[1mbold\x1b[0m"),
    Run("rigel graph", "x"),
]

WRONG = "rigel -f no-such check"


def test_output_and_colors_are_in_the_picture() -> None:
    """Each line is a text of its own; a color is a class, which has a light and a dark form."""
    text = draw("A title", RUNS)
    lines = [
        "".join(one.itertext()) for one in ElementTree.fromstring(text).iter() if "text" in one.tag
    ]
    assert lines == ["$ rigel check", "one <two>", "red bold", "$ rigel graph", "x"]
    assert '<tspan class="c1">red</tspan> <tspan class="bold">bold</tspan>' in text


def test_without_motion_one_screen_is_shown() -> None:
    """All others are hidden unless they are animated."""
    text = draw("A title", RUNS)
    assert re.findall(r'<g id="s(\d)" visibility="hidden">', text) == ["0"]
    assert text.index("prefers-reduced-motion: no-preference") < text.index("@keyframes")


@pytest.mark.programs
@pytest.mark.parametrize("live", [True, False])
def test_a_command_is_run_for_real(tmp_path: Path, *, live: bool) -> None:
    """In a terminal or not, with what it prints to both of its outputs."""
    assert "no-such" in run(WRONG, tmp_path, context="none", live=live, code=2).output
    with pytest.raises(RuntimeError, match="ended with 2"):
        run(WRONG, tmp_path, context="none", live=live)


@pytest.mark.programs
def test_a_terminal_is_as_wide_as_the_picture(tmp_path: Path) -> None:
    """What is wider would be outside of it."""
    (tmp_path / "Rigelfile").write_text("{" + "key: 1, " * 100 + "}")
    output = run("rigel check", tmp_path, context="none", code=2).output
    shown = re.sub(r"\x1b\[[\d;]*m", "", output)
    assert max(len(line) for line in shown.splitlines() if " | " in line) == COLUMNS


def test_the_picture_is_of_todays_commands() -> None:
    """Its drawing is today's: run `python -m tools.recording` after a change."""
    text = (ROOT / "docs" / "recording.svg").read_text("utf-8")
    assert text.count('<g id="s') == 4
    style = re.search(r"<style>(.*?)@media \(prefers-reduced", draw("x", RUNS), re.S)
    assert style
    assert style[1] in text

"""Each program that the code or a test starts is there after `./run test`, or need not be.

A machine that has more than Debian's smallest system hides a missing line of `./run`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: What Debian's smallest system has: packages with `Essential: yes`, and what those need.
ESSENTIAL = {
    *("bash", "chroot", "cp", "dpkg-deb", "mkfifo", "nice", "nsenter", "sh", "sleep", "stat"),
    *("umount", "unshare"),
}
#: Installed by `./run` with another of its programs.
BESIDE = {"bridge": "ip", "mosquitto_passwd": "mosquitto", "pkill": "pgrep"}
#: What nothing installs, and why.
ELSEWHERE = {
    "apt-get": "part of Debian and Ubuntu, which are required",
    "docker": "installing it would start an engine beside whatever the machine runs",
    "docker-registry": "downloaded and unpacked by the test that uses it",
    "go": "downloaded where programs are compiled",
    "pip": "in the virtual environment",
    "pip3": "the same, by another name",
    "promtool": "built with Prometheus",
    "rospack": "in the image",
    "tests/bounds": "a script of the tests",
}


def started() -> Iterator[tuple[str, str]]:
    """Yield (program, place) for each call that names a program as it stands."""
    for top in ("src", "tests"):
        for file in sorted((ROOT / top).rglob("*.py")):
            for call in ast.walk(ast.parse(file.read_text())):
                if isinstance(call, ast.Call) and call.args and starts_a_program(call, top):
                    for program in first_word(call.args[0]):
                        yield program, f"{file.relative_to(ROOT)}:{call.lineno}"


def starts_a_program(call: ast.Call, top: str) -> bool:
    """Return whether it is subprocess's, shutil.which, or the source's own `run([...])`."""
    match call.func:
        case ast.Attribute(value=ast.Name(id="subprocess")) | ast.Attribute(attr="which"):
            return True
        case ast.Name(id="run"):
            return top == "src" and isinstance(call.args[0], ast.List)
    return False


def first_word(node: ast.expr) -> Iterator[str]:
    """Yield the program, where it is a word that is looked up on PATH."""
    while isinstance(node, ast.List | ast.Tuple) and node.elts:
        node = node.elts[0]
    word = node.value if isinstance(node, ast.Constant) else None
    if isinstance(word, str) and not word.startswith("/"):
        yield word


def installed(script: str) -> set[str]:
    """Return the programs that `./run` installs: `packages FILE PACKAGE ...`."""
    text = script.replace("\\\n", " ")
    files = {
        file
        for line in re.findall(r"^ *packages (.+?)(?: \|\|)?$", text, re.M)
        for file in line.split()[::2]
    }
    return {Path(file).name for file in files} | {"cargo"}  # by a function of its own


PLACES: dict[str, str] = dict(reversed(list(started())))


@pytest.mark.parametrize("program", sorted(PLACES))
def test_each_program_is_installed_or_need_not_be(program: str) -> None:
    """Its package has a place in `./run`, or its name a reason here."""
    known = installed((ROOT / "run").read_text())
    known |= {program for program, beside in BESIDE.items() if beside in known}
    assert program in known | ESSENTIAL | set(ELSEWHERE), PLACES[program]


def test_each_exception_is_of_a_program_that_is_started() -> None:
    """A reason goes with its program."""
    assert {*ELSEWHERE, *BESIDE, *ESSENTIAL} <= set(PLACES)


def test_a_missing_line_is_noticed() -> None:
    """As that of Graphviz once was."""
    script = (ROOT / "run").read_text()
    assert "dot" in installed(script)
    assert "dot" not in installed(script.replace("/bin/dot graphviz", ""))

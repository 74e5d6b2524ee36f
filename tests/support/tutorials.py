"""Follow a page of docs/tutorials: its blocks are run as they stand there, in their order.

A `yaml` block with a title is written to that file, which must pass `rigel check`. A `shell` block
is run, and the `text` block behind it is what it prints; `...` stands for anything. A block that
needs more than a directory says what in a comment above it: `<!-- not run: it needs a cluster -->`.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

import attrs

FOLDER = Path(__file__).parents[2] / "docs" / "tutorials"
BLOCK = re.compile(
    r'^(?:<!-- (?P<comment>[^\n]*) -->\n)?```(?P<language>\w+)(?: title="(?P<title>[^"\n]*)")?\n'
    r"(?P<text>.*?)^```$",
    re.M | re.S,
)
#: The beginning of any code block of Markdown, also of one that BLOCK does not read: indented, with
#: other characters, or without them, by four spaces after an empty line.
BEGINNING = re.compile(r"^(?:[ \t>]*(?:`{3,}|~{3,})|(?<=\n\n) {4}\S)", re.M)
REASON = re.compile(r"not run: \w.+")
NEEDS_CLUSTER = "not run: it needs a cluster"


@attrs.frozen
class Block:
    """A code block of a page, and the comment above it."""

    language: str
    text: str
    title: str
    comment: str
    line: int


def read_blocks(text: str) -> list[Block]:
    """Return the code blocks of a page, in their order."""
    return [
        Block(
            found["language"],
            found["text"],
            found["title"] or "",
            found["comment"] or "",
            text[: found.start("language")].count("\n") + 1,
        )
        for found in BLOCK.finditer(text)
    ]


def find_overlooked(text: str) -> Iterator[str]:
    """Yield the code blocks of a page that `follow` neither runs nor finds a reason for."""
    blocks = read_blocks(text)
    for block in blocks:
        if block.language not in ("yaml", "shell", "text"):
            yield f"line {block.line}: {block.language} is not run"
        elif block.language == "yaml" and not block.title:
            yield f"line {block.line}: a file without a name"
        elif block.comment and not REASON.fullmatch(block.comment):
            yield f"line {block.line}: no reason: {block.comment}"
    shown = [index for index, block in enumerate(blocks) if block.language == "text"]
    for index in shown:
        if index == 0 or blocks[index - 1].language != "shell":
            yield f"line {blocks[index].line}: no command prints it"
    rest = BLOCK.sub(lambda found: "\n" * found[0].count("\n"), text)
    for found in BEGINNING.finditer(rest):
        yield f"line {rest[: found.start()].count(chr(10)) + 1}: a block that is not read"


def make_place(directory: Path, programs: dict[str, list[str]]) -> Path:
    """Return an empty directory; a shell there has these programs, by their command lines."""
    (directory / "bin").mkdir()
    for name, words in programs.items():
        program = directory / "bin" / name
        program.write_text(f'#!/bin/sh\nexec {" ".join(words)} "$@"\n')
        program.chmod(0o755)
    place = directory / "robot"
    place.mkdir()
    return place


RIGEL = [sys.executable, "-m", "rigel_k8s"]


def run(command: str, place: Path) -> subprocess.CompletedProcess[str]:
    """Run a block as a reader's shell does; its first error ends it."""
    return subprocess.run(
        ["bash", "-e", "-c", command],
        cwd=place,
        env={
            **os.environ,
            "PATH": f"{place.parent / 'bin'}:{os.environ['PATH']}",
            "NO_COLOR": "1",
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
        check=False,
    )


def follow(text: str, place: Path, *, cluster: bool = False) -> Iterator[str]:
    """Do what a page says, and yield what is wrong with it."""
    printed: str | None = None
    for block in read_blocks(text):
        where = f"line {block.line}: {block.text}"
        if block.language == "yaml" and block.title:
            (place / block.title).write_text(block.text)
            done = run(f"rigel -f {block.title} check", place)
            if done.returncode:
                yield f"{where}\n{done.stdout}"
        elif block.language == "shell":
            printed = None
            if block.comment and not (cluster and block.comment == NEEDS_CLUSTER):
                continue
            done = run(block.text, place)
            printed = done.stdout
            if done.returncode:
                yield f"{where}\n{printed}"
        elif block.language == "text" and printed is not None:
            shown = show_form(block.text) if cluster else block.text
            if not shows(shown, show_form(printed) if cluster else printed):
                yield f"{where}\n{printed}"


def shows(shown: str, printed: str) -> bool:
    """Return whether a command printed what the page shows; `...` stands for anything."""
    pattern = re.sub(r"([\[\]*?])", r"[\1]", shown.strip()).replace("...", "*")
    return fnmatchcase(printed.strip(), pattern)


def show_form(text: str) -> str:
    """Return an output without what differs on each cluster: names with digits, order, widths."""
    lines = (re.sub(r"\s+", " ", re.sub(r"\S*\d\S*", "N", line)) for line in text.splitlines())
    return "\n".join(sorted(filter(None, lines)))

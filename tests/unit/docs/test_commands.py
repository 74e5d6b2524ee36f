"""docs/cli.md describes the commands that exist."""

from __future__ import annotations

import re
from pathlib import Path

import click

from rigel_k8s.cli.main import cli

PAGE = (Path(__file__).parents[3] / "docs" / "cli.md").read_text("utf-8")


def test_every_command_is_described() -> None:
    """In a table before the section on arguments, alone in its cell or beside another one."""
    tables = PAGE.partition("\n## Arguments\n")[0]
    cells = re.findall(r"^\| (`.*?`(?:, `.*?`)*) \|", tables, re.M)
    described = {name.split()[0] for cell in cells for name in re.findall(r"`([a-z][^`]*)`", cell)}
    commands = set(cli.list_commands(click.Context(cli)))
    assert len(commands) > 20
    assert commands - described == set()

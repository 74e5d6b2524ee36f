"""What only a shell understands, in command lines that no shell reads."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PurePosixPath

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import SHELLS
from rigel_k8s.app.starting import split
from rigel_k8s.problems import Problem

OPERATORS = frozenset(("&&", "||", "|", ";", ">", ">>", "<", "2>&1"))
#: Commands that only a shell has.
BUILT_IN = ("source", ".", "export", "cd")


def split_args(node: NodeOptions) -> list[str]:
    """Return the words of `args`; none if they cannot be split, which others report."""
    try:
        return split(node, node.args or [])
    except ValueError:
        return []


def runs_shell(node: NodeOptions) -> bool:
    """Return whether a shell reads `args`."""
    try:
        line = split(node, node.command or []) or split_args(node)
    except ValueError:
        return False
    return bool(line) and PurePosixPath(line[0]).name in SHELLS


def check_shell_words(node: NodeOptions) -> Iterator[Problem]:
    """Yield words of `args` that a shell would act on."""
    words = split_args(node)
    if runs_shell(node):
        return
    found = [word for word in words if word in OPERATORS]
    if node.command is None and node.package is None and words[:1] and words[0] in BUILT_IN:
        found.insert(0, words[0])
    if found:
        message = f'no shell reads args, so "{found[0]}" is a plain word: write [bash, -c, "..."]'
        yield Problem(("args",), message, "no-shell", severity="warning", at_key=True)

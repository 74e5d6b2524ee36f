"""This package inside Rigel 0.3: job types as Rigel's plugins, and `rigel` handing over to Rigel.

pip lets Rigel and this package overwrite each other's `bin/rigel` silently. If ours is the
one that remains, `rigel run` and `rigel init` do what Rigel's script would have done; all other
commands, and everything under `rigel-k8s` and `python -m rigel_k8s`, are ours (docs/rigel.md).

Rigel is never imported from here unless it has been imported already, or `rigel run` is typed where
it is installed. It uses the interface of job types and is independent of what they do.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

RIGELS_COMMANDS = frozenset({"init", "run"})


def handover(argv: Sequence[str]) -> Callable[[], Any] | None:
    """Return Rigel's entry point if the command line is Rigel's to run, else None.

    Args:
        argv: sys.argv: the program as it was called, and its arguments. Options before the command
            are this package's own, so such a line is ours.
    """
    if len(argv) < 2 or Path(argv[0]).name != "rigel" or argv[1] not in RIGELS_COMMANDS:
        return None
    if not is_installed():
        return None
    entry: Callable[[], Any] = importlib.import_module("rigel.main").main
    return entry


def is_installed() -> bool:
    """Return whether Rigel 0.3 can be imported; 0.2 has no orchestrator and another grammar."""
    try:
        return all(importlib.util.find_spec(f"rigel.{name}") for name in ("main", "orchestrator"))
    except ImportError:  # no package `rigel`, or a broken one
        return False

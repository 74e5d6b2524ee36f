"""The gate's own files, as they are mounted into its container."""

from __future__ import annotations

from importlib.resources import files


def program() -> dict[str, str]:
    """Return the files, name to text."""
    room = files("rigel_gate")
    return {
        entry.name: entry.read_text(encoding="utf-8")
        for entry in sorted(room.iterdir(), key=lambda entry: entry.name)
        if entry.name.endswith((".py", ".xml")) and entry.name != "program.py"
    }

"""`python -m tools.boards`: write the dashboards' JSON."""

from __future__ import annotations

from tools.boards import write

write()

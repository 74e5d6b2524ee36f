"""The pages of the reference that are made from tables in the code.

`PAGES` has each page with the function that writes it. `python -m tools.reference` writes them
all; `tests/unit/docs/test_reference.py` fails where one is not what the code says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from tools.reference.alerts import write_alerts
from tools.reference.kinds import write_kinds
from tools.reference.metrics import write_metrics
from tools.reference.options import write_options

PAGES: Mapping[str, Callable[[], str]] = {
    "errors.md": write_kinds,
    "metrics.md": write_metrics,
    "alerts.md": write_alerts,
    "reference.md": write_options,
}

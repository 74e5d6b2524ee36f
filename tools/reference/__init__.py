"""The pages of the reference that are made from tables in the code.

`PAGES` has each page with the function that writes it. `python -m tools.reference` writes them
all; `tests/unit/docs/test_reference.py` fails where one is not what the code says. The page of
options is made by the package itself (rigelfile/reference.py).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from tools.reference.alerts import write_alerts
from tools.reference.kinds import write_kinds
from tools.reference.metrics import write_metrics

PAGES: Mapping[str, Callable[[], str]] = {
    "errors.md": write_kinds,
    "metrics.md": write_metrics,
    "alerts.md": write_alerts,
}

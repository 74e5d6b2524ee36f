"""How `rigel cluster` shows its steps, of which some take minutes: lines, and a row that moves."""

from __future__ import annotations

import threading
import time

from rigel_k8s.cli.reports import Rows
from rigel_k8s.report import Reporter
from rigel_lab import cluster

#: Seconds between two lines about one step, where no row can move.
LINE_EVERY = 15
#: The key of the one row; several steps may run at the same time, and the last one is shown.
ROW = ""


class Steps:
    """A Reporter that shows each step with the seconds since the start.

    In a terminal the present step is a row with what it does and its age, and becomes a line when
    the next one begins. Elsewhere each step is a line when it begins, and how far it is another
    one from time to time.
    """

    def __init__(self, reporter: Reporter) -> None:
        self._reporter = reporter
        self._begin = self._printed = time.monotonic()
        self._step = ""  # the line of the step that is a row
        self._lock = threading.Lock()

    def warn(self, text: str) -> None:
        self.line(text)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Ignore what happens within a step."""

    def line(self, text: str) -> None:
        """Show the next step, or how far the present one is."""
        with self._lock:
            line = f"{time.monotonic() - self._begin:5.0f} s  {text}"
            is_step = not isinstance(text, cluster.StepProgress)
            if isinstance(self._reporter, Rows):
                if is_step:
                    self._keep(self._reporter)
                    self._step = line
                self._reporter.progress(ROW, text)
            elif is_step or time.monotonic() - self._printed > LINE_EVERY:
                self._printed = time.monotonic()
                self._reporter.line(line)

    def close(self) -> None:
        """Print the last step."""
        with self._lock:
            if isinstance(self._reporter, Rows):
                self._keep(self._reporter)

    def _keep(self, rows: Rows) -> None:
        """Make a line of the row, if there is one."""
        if self._step:
            rows.progress(ROW, "", done=True)
            rows.line(self._step)
            self._step = ""

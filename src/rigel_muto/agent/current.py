"""What the device's twin in Ditto reports: `current`, the stack and its state.

Ditto may be unreachable: only the newest state is kept, and written when Ditto answers again.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.report import Reporter
from rigel_muto.agent.wanted import Record
from rigel_muto.ditto import Ditto

CURRENT = "/features/stack/properties/current"
MERGE = "application/merge-patch+json"
#: What a device's thing has; existing parts of these stay.
THING: Mapping[str, Any] = {
    "features": {name: {"properties": {}} for name in ("context", "stack", "telemetry")}
}
#: Seconds before a write that failed is tried again.
AGAIN = 5.0


def describe_current(record: Record) -> dict[str, str]:
    """Return what the twin reports: the stack, its state, and why it failed."""
    said = {"stackId": record.label, "state": record.state}
    return {**said, "cause": record.cause} if record.cause else said


class Announcer:
    """A thread that keeps `current` of a thing as it was last set."""

    def __init__(self, ditto: Ditto, thing: str, report: Reporter) -> None:
        self._ditto = ditto
        self._thing = thing
        self._report = report
        self._changed = threading.Condition()
        self._next: Mapping[str, str] | None = None
        self._closed = False
        self._known = False
        self._away = False
        self._thread = threading.Thread(target=self._work, name="twin", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def set(self, current: Mapping[str, str]) -> None:
        """Write this soon, in place of what was not written yet."""
        with self._changed:
            self._next = current
            self._changed.notify()

    def close(self, patience: float = AGAIN) -> None:
        """Write what is left, if Ditto answers within some seconds."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(patience)

    def _work(self) -> None:
        while True:
            with self._changed:
                while self._next is None and not self._closed:
                    self._changed.wait()
                current = self._next
            if current is None:
                return
            written = self._try(current)
            with self._changed:
                if written and self._next is current:
                    self._next = None
                if not written:
                    if self._closed:
                        return
                    self._changed.wait(AGAIN)

    def _try(self, current: Mapping[str, str]) -> bool:
        """Write; return whether it worked, and report only a change of that."""
        try:
            if not self._known:
                self._register()
                self._known = True
            self._send("PUT", CURRENT, current)
        except RigelK8sError as error:
            if not self._away:
                self._report.warn(f"the twin is not up to date: {error.message}; trying again")
            self._away = True
            self._known = False
            return False
        if self._away:
            self._report.line("the twin is up to date again")
        self._away = False
        return True

    def _register(self) -> None:
        """Create the thing in Ditto."""
        url = self._ditto.url_of(self._thing)
        if self._ditto.request("PATCH", url, THING, MERGE).status in (400, 404):
            self._send("PUT", "", THING)

    def _send(self, method: str, path: str, body: object) -> None:
        url = self._ditto.url_of(self._thing, path)
        answer = self._ditto.request(method, url, body)
        if answer.status >= 300:
            raise RigelK8sError(f"{url} answered {answer.status}")

"""The Rigelfile's providers, connected before the first job and disconnected however a run ends."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import attrs

from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.jobs.job import JobReporter, ProviderType


@attrs.frozen
class Declared:
    """A provider of the Rigelfile with its options, not connected."""

    name: str
    type: ProviderType[Any]
    options: Any


class Providers:
    """Connections by the providers' names; `disconnect` may be called at any time, and twice."""

    def __init__(self, declared: Sequence[Declared], report: JobReporter) -> None:
        self.connections: dict[str, Any] = {}
        self._declared = declared
        self._report = report
        self._open: list[Declared] = []
        self._lock = threading.Lock()
        self._closed = False

    def connect(self, stop: threading.Event) -> None:
        """Connect all in the Rigelfile's order, until `stop` is set.

        Raises:
            RigelK8sError: one could not connect; the error names it.
        """
        for declared in self._declared:
            if stop.is_set():
                return
            try:
                connection = declared.type.connect(declared.options, declared.name, self._report)
            except RigelK8sError as error:
                raise _failure(declared.name, error) from error
            if not self._keep(declared, connection):
                declared.type.disconnect(connection)

    def disconnect(self) -> None:
        """Disconnect all in reverse order; an error is reported and does not stop the others."""
        with self._lock:
            self._closed = True
            ending, self._open = self._open[::-1], []
        for declared in ending:
            try:
                declared.type.disconnect(self.connections[declared.name])
            except Exception as error:
                self._report.warn(f"provider {declared.name} did not disconnect: {error}")

    def _keep(self, declared: Declared, connection: Any) -> bool:
        """Note a connection; False if the run has ended while it was made."""
        with self._lock:
            if not self._closed:
                self.connections[declared.name] = connection
                self._open.append(declared)
            return not self._closed


def _failure(name: str, error: RigelK8sError) -> RigelK8sError:
    kind = UserError if isinstance(error, UserError) else RigelK8sError
    return kind(
        f"provider {name} could not connect: {error.message}",
        hint=error.hint,
        details=error.details,
    )

"""What a job uses exclusively while it runs (such as a release): a second user is refused."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from rigel_k8s.errors import UserError


class Holds:
    """What the jobs of a run hold at this moment."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._held: dict[str, str] = {}

    @contextmanager
    def hold(self, key: str | None, where: str) -> Iterator[None]:
        """Hold a key while the context is open; None holds nothing.

        Args:
            where: the job, for the error of another one.

        Raises:
            UserError: another job holds it.
        """
        if key is None:
            yield
            return
        with self._lock:
            other = self._held.get(key)
            if other is None:
                self._held[key] = where
        if other is not None:
            raise UserError(
                f"{other} works on {key} at the same time",
                hint="run them one after the other, or give them different names",
            )
        try:
            yield
        finally:
            with self._lock:
                del self._held[key]

"""Whether the cluster answers: asked every few seconds, for as long as a page is served."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube import Cluster
from rigel_k8s.kube.failures import Refusal

HEARTBEAT = 3.0  # seconds between two requests
LATE = 10.0  # seconds without an answer after which the cluster counts as unreachable


class Contact:
    """Asks a cluster until it is closed.

    Args:
        report: takes a line for the terminal when the cluster becomes unreachable, and when it
            answers again.
        lose: is called with what is wrong when it becomes unreachable.

    Attributes:
        lost: set while the cluster does not answer, and at the end.
    """

    def __init__(
        self, cluster: Cluster, report: Callable[[str], None], lose: Callable[[str], None]
    ) -> None:
        self.lost = threading.Event()
        self._cluster, self._report, self._call = cluster, report, lose
        self._over = threading.Event()
        self._answered = time.monotonic()

    def close(self) -> None:
        """End, without waiting for an answer."""
        self._over.set()
        self.lost.set()

    def run(self) -> None:
        """Ask, and note the cluster's loss if an answer is late."""
        threading.Thread(target=self._ask, name="rigel-ui-ask", daemon=True).start()
        while not self._over.wait(1.0):
            if time.monotonic() - self._answered > LATE:
                self._lose(f"the cluster at {self._cluster.server} does not answer")

    def _ask(self) -> None:
        while not self._over.is_set():
            try:
                self._cluster.server_version()
            except Refusal as error:
                # A refusal is an answer as well: the user has no right to read the version.
                if error.status == 0 or error.status >= 500:
                    self._lose(error.message)
                else:
                    self._find()
            except RigelK8sError as error:
                self._lose(error.message)
            else:
                self._find()
            self._over.wait(HEARTBEAT)

    def _find(self) -> None:
        self._answered = time.monotonic()
        if self.lost.is_set() and not self._over.is_set():
            self.lost.clear()
            self._report("the cluster answers again")

    def _lose(self, message: str) -> None:
        if not self.lost.is_set():
            self.lost.set()
            self._report(f"{message}; waiting for it")
            self._call(message)

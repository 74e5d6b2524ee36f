"""What is read once when a page asks for it: the next message of a topic, parameters of a node.

Nothing is subscribed to before, or afterwards. A reading whose page has gone ends by itself soon.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from rigel_graph.commands.params import read_parameters
from rigel_graph.commands.topics import SHORT, follow
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.yaml_text import write_value
from rigel_ui.graphs import write_now

WITHIN = 20.0  # seconds in which a message must come
MOST = 4  # readings at a time: of a browser's six connections a page's stream needs one

Read = Callable[[str], Mapping[str, Any]]


class Readings:
    """Reads for all pages.

    Args:
        kinds: what reads by a name, by kind.
    """

    def __init__(self, kinds: Mapping[str, Read]) -> None:
        self.kinds = kinds
        self._free = threading.Semaphore(MOST)

    def read(self, kind: str, name: str) -> Mapping[str, Any]:
        """Return what was read, and when in `read`; or `error` with the hint as its last line."""
        if not self._free.acquire(blocking=False):
            return {"error": f"{MOST} other readings are in progress\ntry again in some seconds"}
        try:
            return {**self.kinds[kind](name), "read": write_now()}
        except RigelK8sError as error:
            return {"error": "\n".join([error.message, *error.details, error.hint or ""]).rstrip()}
        finally:
            self._free.release()


def list_kinds(found: Release) -> Mapping[str, Read]:
    """Return what reads a release that is connected."""

    def read_message(topic: str) -> Mapping[str, Any]:
        one = next(follow(found, topic, count=1, most=SHORT, within=WITHIN), None)
        if one is None:
            raise ClusterError("the pod has ended before a message came", hint="try again")
        return {"text": write_value(one["message"]), "shortened": one["shortened"]}

    def read_rows(node: str) -> Mapping[str, Any]:
        values = read_parameters(found, node, ()).values
        return {"rows": [[name, write_value(one, flow=True)] for name, one in values.items()]}

    return {"message": read_message, "parameters": read_rows}

"""The exporter's configuration, a JSON file that `rigel` writes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

INTERVAL = 10.0
PORT = 9419
JOINING = 4.0


class ConfigFailed(Exception):
    """The file cannot be used; the message has the cause."""


class Config(NamedTuple):
    """The file's fields; all may be left out.

    Attributes:
        ros: "1", "2", or "none" for DDS without ROS.
        middleware: exported in ros_exporter_info, "" for none.
        name: the exporter's own ROS 1 name.
        master_uri: ROS 1's master.
        domain: DDS' domain.
        mode: how participants find each other: multicast, peers or discovery-server.
        interface: the network interface for DDS, None for any.
        peers: names or addresses to which the exporter announces itself.
        servers: discovery servers, HOST or HOST:PORT.
        keepers: where ROS 2 processes' notes are read, NAME:PORT: at each address of the name, at
            this port and the next three. Empty: the graph is read from DDS.
        expected: ROS names of nodes that must exist, and the workload of each.
        known: the same for nodes that may have another name.
        once: names of nodes that end, and are not missing afterwards.
        topics: topics to measure, in addition to those of the next three fields; with `keepers`,
            their nodes count, and only the next three are subscribed to.
        contract: what is expected of topics: fields of expecting.Expected, by their full names.
        diagnostics: subscribe to /diagnostics.
        clock: subscribe to /clock.
        tf: subscribe to /tf.
        interval: seconds between two looks at the graph.
        port: where metrics are served; 0 for any free one, which is printed.
        joining: seconds in which a new participant of DDS discovers the others; before that, all
            nodes seem to be missing.
    """

    ros: str = "1"
    middleware: str = ""
    name: str = "/ros_exporter"
    master_uri: str = "http://localhost:11311"
    domain: int = 0
    mode: str = "multicast"
    interface: str | None = None
    peers: Sequence[str] = ()
    servers: Sequence[str] = ()
    keepers: Sequence[str] = ()
    expected: Mapping[str, str] = {}
    known: Mapping[str, str] = {}
    once: Sequence[str] = ()
    topics: Sequence[str] = ()
    contract: Mapping[str, Mapping[str, Any]] = {}
    diagnostics: bool = False
    clock: bool = False
    tf: bool = False
    interval: float = INTERVAL
    port: int = PORT
    joining: float = JOINING


def read(path: Path) -> Config:
    """Return the configuration in a file, as `rigel` writes it.

    Raises:
        ConfigFailed: it does not exist, is not JSON, or is that of another version.
    """
    try:
        fields = json.loads(path.read_text("utf-8"))
        unknown = sorted(set(fields) - set(Config._fields))
    except (OSError, ValueError, TypeError) as error:
        raise ConfigFailed(f"{path}: {error}") from error
    if unknown:
        raise ConfigFailed(f"{path}: unknown field {unknown[0]}; is it of another version?")
    return Config(**fields)

"""What the exporter is told, by one JSON file: checked here, so that nothing else has to be."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

INTERVAL = 10.0
PORT = 9419
JOINING = 4.0


class ConfigFailed(Exception):
    """The file cannot be used; the message says what is wrong with which field."""


class Config(NamedTuple):
    """The file's fields; all may be left out.

    Attributes:
        ros: "1", "2", or "none" for DDS without ROS.
        middleware: told in ros_exporter_info, "" for none.
        name: the exporter's own ROS 1 name.
        master_uri: ROS 1's master.
        domain: DDS' domain.
        mode: how participants find each other: multicast, peers or discovery-server.
        interface: the network interface for DDS, None for any.
        peers: names or addresses that are told of the exporter.
        servers: discovery servers, HOST or HOST:PORT.
        expected: ROS names of nodes that there must be, and the workload of each.
        known: the same for nodes that may have another name.
        topics: topics to hear; nothing else is subscribed but what the next three ask for.
        diagnostics: hear /diagnostics.
        clock: hear /clock.
        tf: hear /tf.
        interval: seconds between two looks at the graph.
        port: where metrics are served; 0 for any free one, which is printed.
        joining: seconds in which a participant of DDS that has just joined hears of the others;
            before, all seem gone.
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
    expected: Mapping[str, str] = {}
    known: Mapping[str, str] = {}
    topics: Sequence[str] = ()
    diagnostics: bool = False
    clock: bool = False
    tf: bool = False
    interval: float = INTERVAL
    port: int = PORT
    joining: float = JOINING


_CHOICES = {"ros": ("1", "2", "none"), "mode": ("multicast", "peers", "discovery-server")}


def read(path: Path) -> Config:
    """Return what a file says.

    Raises:
        ConfigFailed: it is not there, no JSON, or a field is not what it must be.
    """
    try:
        told = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigFailed(f"{path}: {error}") from error
    if not isinstance(told, dict):
        raise ConfigFailed(f"{path}: a JSON object is wanted")
    unknown = sorted(set(told) - set(Config._fields))
    if unknown:
        raise ConfigFailed(f"{path}: unknown field {unknown[0]}")
    for field, value in told.items():
        _check(path, field, value)
    return Config(**told)


def _check(path: Path, field: str, value: Any) -> None:
    default = Config._field_defaults[field]
    if field in _CHOICES and value not in _CHOICES[field]:
        raise ConfigFailed(f"{path}: {field} is one of {', '.join(_CHOICES[field])}")
    if not _is_like(default, value):
        raise ConfigFailed(f"{path}: {field} cannot be {json.dumps(value)}")


def _is_like(default: Any, value: Any) -> bool:
    """Return whether a value is of its default's kind; numbers are positive, or a domain's 0."""
    if default is None:
        return value is None or isinstance(value, str)
    if isinstance(default, bool) or isinstance(value, bool):
        return isinstance(default, bool) and isinstance(value, bool)
    if isinstance(default, float):
        return isinstance(value, (int, float)) and value > 0
    if isinstance(default, int):
        return isinstance(value, int) and value >= 0
    if isinstance(default, tuple):
        return isinstance(value, list) and all(isinstance(item, str) for item in value)
    if isinstance(default, dict):
        return isinstance(value, dict) and all(isinstance(item, str) for item in value.values())
    return isinstance(value, str)

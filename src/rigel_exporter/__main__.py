"""`python3 -m rigel_exporter CONFIG.json`: run the exporter until a signal ends it."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from rigel_exporter.collection import Collection, Server
from rigel_exporter.config import Config, ConfigFailed, read
from rigel_exporter.graph import Half

if TYPE_CHECKING:
    from rigel_exporter.dds import Domain

_SIGNALS = (signal.SIGTERM, signal.SIGINT)


def main(arguments: list[str]) -> int:
    """Serve until SIGTERM or SIGINT; return the exit code, 2 for a wrong configuration."""
    if len(arguments) != 1:
        return _fail("usage: python3 -m rigel_exporter CONFIG.json", 2)
    try:
        config = read(Path(arguments[0]))
    except ConfigFailed as error:
        return _fail(str(error), 2)
    # A handler that sets an Event would wait for itself if the second signal came within the first.
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)  # in the threads that follow, too
    half = _make_half(config)
    try:
        return _serve(half, config)
    finally:
        half.close()


def _serve(half: Half, config: Config) -> int:
    joins = config.ros != "1" and not config.keepers
    collection = Collection(half, config, after=config.joining if joins else 0.0)
    try:
        server = Server(config.port, collection.metrics, collection.well)
    except OSError as error:
        return _fail(f"port {config.port}: {error.strerror}", 1)
    with server:
        sys.stdout.write(f"ros-exporter: serving metrics at port {server.server_address[1]}\n")
        sys.stdout.flush()
        collection.start()
        threading.Thread(target=server.serve_forever, name="http", daemon=True).start()
        signal.sigwait(_SIGNALS)
        server.shutdown()
    collection.close()
    return 0


def _make_half(config: Config) -> Half:
    """Return the graph that the configuration names; the other ROS' modules are not imported."""
    if config.ros == "1":
        from rigel_exporter.ros1 import Ros1

        return Ros1(config.master_uri, name=config.name, first=config.expected)
    content = (config.diagnostics or config.clock or config.tf) and config.middleware != "zenoh"
    domain = _join_domain(config) if content or not config.keepers else None
    if domain and not config.keepers:
        return domain
    from rigel_exporter.ros2 import Ros2

    return Ros2(config.keepers, domain)


def _join_domain(config: Config) -> Domain:
    from rigel_exporter.dds import Domain

    domain = Domain(
        domain=config.domain,
        mode=config.mode,
        interface=config.interface,
        peers=config.peers,
        servers=config.servers,
    )
    domain.start()
    return domain


def _fail(text: str, code: int) -> int:
    sys.stderr.write(f"ros-exporter: {text}\n")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

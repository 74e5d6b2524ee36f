"""The lines of docs/ros1-hears-nothing.md that connect to a publisher work as they are written."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest

pytestmark = pytest.mark.programs

PAGE = (Path(__file__).parents[3] / "docs" / "ros1-hears-nothing.md").read_text("utf-8")
(CONNECT,) = re.findall(r"^```shell\nrigel exec listener -- (.*?)^```$", PAGE, re.M | re.S)
(SHOWN,) = re.findall(r"^```text\n(.*?)^```$", PAGE, re.M | re.S)


class Handler(SimpleXMLRPCRequestHandler):
    """Answers at any path, as roscore and nodes do."""

    rpc_paths = ()


@contextmanager
def serve(name: str, answer: list[Any]) -> Iterator[str]:
    """Give the address of a server whose only method has this answer."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), Handler, logRequests=False) as server:
        server.register_function(lambda *_: answer, name)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        thread.join()


def connect(master: str) -> subprocess.CompletedProcess[str]:
    """Run the page's command with a master."""
    env = {**os.environ, "ROS_MASTER_URI": master}
    return subprocess.run(
        ["sh", "-c", CONNECT], env=env, check=False, capture_output=True, text=True, timeout=60
    )


def test_a_publisher_that_can_be_reached() -> None:
    """It prints what the page shows, with other numbers."""
    with socket.create_server(("127.0.0.1", 0)) as topic:
        port = topic.getsockname()[1]
        found = [1, "ready", ["TCPROS", "127.0.0.1", port]]
        with serve("requestTopic", found) as node, serve("lookupNode", [1, "", node]) as master:
            done = connect(master)
    shown = SHOWN.replace("http://10.42.1.5:43121/", node).replace("38983", str(port))
    assert done.stderr == ""
    assert done.stdout == shown.replace("10.42.1.5", "127.0.0.1")


def test_the_last_lines_of_the_table() -> None:
    """A node whose process has ended, one with a name, and one that roscore does not have."""
    with socket.create_server(("127.0.0.1", 0)) as gone:
        ended = f"http://127.0.0.1:{gone.getsockname()[1]}/"
    for address, said in (
        (ended, "ConnectionRefusedError"),
        ("http://talker.invalid:1/", "ame or service not known"),
        ("", "unsupported XML-RPC protocol"),
    ):
        with serve("lookupNode", [1, "", address]) as master:
            done = connect(master)
        assert done.returncode == 1
        assert said in done.stderr.splitlines()[-1]
        assert done.stdout == f"/talker is at {address}\n"

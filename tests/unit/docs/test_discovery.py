"""The commands of docs/discovery.md that test UDP work as they are written."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.programs

PAGE = (Path(__file__).parents[3] / "docs" / "discovery.md").read_text("utf-8")
RECEIVE, SEND = re.findall(r"^```shell\nrigel exec \w+ -- (.*?)^```$", PAGE, re.M | re.S)
(SHOWN,) = re.findall(r"^```text\n(.*?)^```$", PAGE, re.M | re.S)
BOUND = 's.bind(("", 9999))\n'


@pytest.fixture
def receiver() -> Iterator[subprocess.Popen[str]]:
    """The page's receiver on a free port, which it prints first."""
    assert BOUND in RECEIVE
    own = 's.bind(("", 0))\nprint(s.getsockname()[1], flush=True)\n'
    words = ["sh", "-c", RECEIVE.replace(BOUND, own)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as started:
        yield started
        started.kill()


def test_a_packet_goes_there_and_back(receiver: subprocess.Popen[str]) -> None:
    """Both print what the page says."""
    assert receiver.stdout
    port = receiver.stdout.readline().strip()
    command = SEND.replace("ADDRESS", "127.0.0.1").replace("9999", port)
    sent = subprocess.run(["sh", "-c", command], check=True, capture_output=True, text=True)
    assert sent.stdout == SHOWN
    received, _ = receiver.communicate(timeout=60)
    assert (receiver.returncode, received) == (0, "1400 bytes from 127.0.0.1\n")

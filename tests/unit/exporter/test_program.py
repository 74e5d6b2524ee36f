"""What the image has is a program: complete, on the standard library, for Python 3.9."""

from __future__ import annotations

import ast
import json
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

import rigel_exporter
from rigel_k8s import __version__
from rigel_k8s.observability.exporter import DIRECTORY, EXPORTER_IMAGE, FILE
from rigel_k8s.observability.names import EXPORTER_PORT
from rigel_lab.images.exporter import UPSTREAM, entries

pytestmark = pytest.mark.programs


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """The image's files of the program, and nothing else, in a directory."""
    for entry in entries():
        if entry.path.startswith("opt/rigel-k8s/"):
            path = tmp_path / entry.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(entry.content)
    return tmp_path / "opt" / "rigel-k8s"


def run(program: Path, *words: str) -> subprocess.Popen[str]:
    """The program as the image starts it, but without site-packages."""
    return subprocess.Popen(
        [sys.executable, "-S", "-W", "error", "-m", "rigel_exporter", *words],
        env={"PYTHONPATH": str(program), "PATH": "/usr/bin:/bin"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("ros", ["1", "2"])
def test_it_serves_until_it_is_told_to_end(program: Path, tmp_path: Path, ros: str) -> None:
    """Nothing of it is missing; without a master or anybody in the domain it is well."""
    file = tmp_path / "config.json"
    told = {"ros": ros, "port": 0, "interval": 0.1, "master_uri": "http://127.0.0.1:9"}
    more = {"interface": "lo", "joining": 0.01} if ros == "2" else {}
    file.write_text(json.dumps(told | more))
    with run(program, str(file)) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("ros-exporter: serving metrics at port ")
        text = scrape(int(line.split()[-1]), process)
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""
    assert f'ros_exporter_info{{version="{__version__}",ros="{ros}",middleware=""}} 1' in text


def test_many_signals_end_it_as_one_does(program: Path, tmp_path: Path) -> None:
    """The preStop hook sends SIGINT, and the kubelet SIGTERM as soon as the hook has returned."""
    file = tmp_path / "config.json"
    file.write_text(json.dumps({"port": 0, "master_uri": "http://127.0.0.1:9"}))
    for _ in range(10):
        with run(program, str(file)) as process:
            assert process.stdout is not None
            assert process.stdout.readline()
            for number in (signal.SIGINT, signal.SIGTERM) * 100:
                process.send_signal(number)
            try:
                assert process.wait(120) == 0
            finally:
                process.kill()


def scrape(port: int, process: subprocess.Popen[str]) -> str:
    deadline = time.monotonic() + 120
    while True:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30) as answer:
                text = str(answer.read().decode())
            if "ros_exporter_collect_seconds" in text:
                return text
        except OSError:
            pass
        assert process.poll() is None, process.stderr and process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_wrong_configuration_ends_it_with_a_word(program: Path, tmp_path: Path) -> None:
    with run(program, str(tmp_path / "nothing.json")) as process:
        assert process.wait(120) == 2
        assert process.stderr is not None
        assert "ros-exporter: " in process.stderr.read()


def test_every_file_is_one_that_python_3_9_reads(program: Path) -> None:
    for path in program.rglob("*.py"):
        ast.parse(path.read_text(), str(path), feature_version=(3, 9))


def test_pods_ask_for_the_image_that_is_built() -> None:
    """The name, the configuration's place and the port are said twice: here and there."""
    from rigel_exporter.config import PORT
    from rigel_lab.images.exporter import IMAGE

    assert EXPORTER_IMAGE == UPSTREAM
    assert IMAGE.config["Cmd"] == [f"{DIRECTORY}/{FILE}"]
    assert PORT == EXPORTER_PORT


def test_its_version_is_that_of_the_command_line() -> None:
    """It is in an image of its own, where the other packages are not."""
    assert rigel_exporter.__version__ == __version__

"""`rigel ui` as a program: how it begins, what it says, how it ends."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.support.http_server import serving
from tests.support.until import until

pytestmark = pytest.mark.programs

KUBECONFIG = """
apiVersion: v1
kind: Config
current-context: lab
contexts: [{name: lab, context: {cluster: lab, user: lab, namespace: robots}}]
clusters: [{name: lab, cluster: {server: "http://127.0.0.1:%d"}}]
users: [{name: lab, user: {}}]
"""
NO_ONE = 1  # a port at which nothing listens


@contextmanager
def rigel_ui(
    directory: Path, *words: str, port: int = NO_ONE, **variables: str
) -> Iterator[subprocess.Popen[str]]:
    """Run `rigel ui` in a directory; its output is in `out` and `err` there."""
    (directory / "kubeconfig").write_text(KUBECONFIG % port)
    own = {**os.environ, "KUBECONFIG": str(directory / "kubeconfig"), **variables}
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        if name not in variables:
            own.pop(name, None)
    with (directory / "out").open("w") as out, (directory / "err").open("w") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "rigel_k8s", "ui", *words],
            cwd=directory,
            env=own,
            stdout=out,
            stderr=err,
            text=True,
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait(60)


def find_address(directory: Path) -> str:
    """Return the address that was printed."""
    return until(lambda: (directory / "out").read_text().strip(), "an address", 120)


def fetch(address: str) -> str:
    with urllib.request.urlopen(address, timeout=60) as answer:
        return str(answer.read().decode())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_ended(tmp_path: Path, number: signal.Signals) -> None:
    """Also where the cluster is away, which the terminal says once; its end is no failure."""
    with rigel_ui(tmp_path, "demo") as process:
        address = find_address(tmp_path)
        assert "<title>rigel ui</title>" in fetch(address)
        told = until(lambda: (tmp_path / "err").read_text().count("does not answer"), "a word", 60)
        assert told == 1
        process.send_signal(number)
        assert process.wait(60) == 0
    told = (tmp_path / "err").read_text()
    assert "Traceback" not in told
    assert address.rstrip("/").rpartition("/")[2] not in told, "the token is in the address only"
    assert (tmp_path / "out").read_text() == f"{address}\n"


def test_an_open_page_does_not_keep_it_from_ending(tmp_path: Path) -> None:
    """Connections are closed."""
    with rigel_ui(tmp_path, "demo") as process:
        address = find_address(tmp_path)
        with urllib.request.urlopen(f"{address}live", timeout=60) as page:
            assert any(b"cluster" in line for line in page), "the page is open"
            process.terminate()
            assert process.wait(60) == 0


def test_what_is_asked_is_not_logged(tmp_path: Path) -> None:
    """A log would have the token, and what a page of another site has tried."""
    with rigel_ui(tmp_path, "demo") as process:
        address = find_address(tmp_path)
        token = address.rstrip("/").rpartition("/")[2]
        fetch(address)
        fetch(f"{address}live?behind=yes")
        for wrong in (f"{address.rsplit('/', 2)[0]}/wrong/", f"{address}missing"):
            with pytest.raises(urllib.error.HTTPError) as caught:
                fetch(wrong)
            caught.value.close()
        with socket.create_connection(("127.0.0.1", urlsplit(address).port or 0)) as one:
            one.sendall(f"GARBAGE /{token}/ HTTP/1.1\r\n\r\n".encode())
            assert one.recv(1)
        process.terminate()
        process.wait(60)
    printed = (tmp_path / "err").read_text()
    assert token not in printed
    assert "GET" not in printed
    assert (tmp_path / "out").read_text() == f"{address}\n"


def test_the_browser_gets_an_address_that_works_once(tmp_path: Path) -> None:
    """Its command line, which all users of the machine see, does not have the token."""
    script = tmp_path / "browser"
    script.write_text(f'#!/bin/sh\necho "$1" >{tmp_path}/opened.new\n'
                      f'mv {tmp_path}/opened.new {tmp_path}/opened\n')  # fmt: skip
    script.chmod(0o755)
    with rigel_ui(tmp_path, "demo", DISPLAY=":9", BROWSER=f"{script} %s"):
        address = find_address(tmp_path)
        until((tmp_path / "opened").exists, "the browser", 60)
        opened = (tmp_path / "opened").read_text().strip()
        assert address.rstrip("/").rpartition("/")[2] not in opened
        assert "<title>rigel ui</title>" in fetch(opened)
        with pytest.raises(urllib.error.HTTPError) as caught:
            fetch(opened)
        caught.value.close()
        assert caught.value.code == 403


def test_no_browser_is_opened_where_none_is_asked_for(tmp_path: Path) -> None:
    """Nor where there is no display."""
    script = tmp_path / "browser"
    script.write_text(f"#!/bin/sh\ntouch {tmp_path}/opened\n")
    script.chmod(0o755)
    for words, variables in ((["--no-browser"], {"DISPLAY": ":9"}), ([], {})):
        with rigel_ui(tmp_path, "demo", *words, BROWSER=f"{script} %s", **variables) as process:
            fetch(find_address(tmp_path))
            until(lambda: "does not answer" in (tmp_path / "err").read_text(), "its start", 60)
            process.terminate()
            process.wait(60)
        (tmp_path / "out").unlink()
    assert not (tmp_path / "opened").exists()


def test_without_allow_changes_the_page_is_read_only(tmp_path: Path) -> None:
    """The option decides whether there is a path that writes at all."""
    for words, status in ((["demo"], 405), (["demo", "--allow-changes"], 400)):
        with rigel_ui(tmp_path, *words):
            address = find_address(tmp_path)
            host = address.split("/")[2]
            request = urllib.request.Request(
                f"{address}rollback", b"{}", {"Origin": f"http://{host}"}, method="POST"
            )
            with pytest.raises(urllib.error.HTTPError) as caught:
                urllib.request.urlopen(request, timeout=60)
            caught.value.close()
            assert caught.value.code == status
        (tmp_path / "out").unlink()


def test_a_cluster_that_comes_back_is_reported(tmp_path: Path) -> None:
    """In the terminal, where someone may wait for it."""
    with socket.socket() as held:  # nobody else gets the port, and nobody listens at it
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(("127.0.0.1", 0))
        port = held.getsockname()[1]
        with rigel_ui(tmp_path, "demo", port=port):
            until(lambda: "; waiting for it" in (tmp_path / "err").read_text(), "the outage", 60)
            with serving(lambda exchange: exchange.say(200, {"gitVersion": "v1"}), port=port):
                until(lambda: "answers again" in (tmp_path / "err").read_text(), "the cluster", 60)


def run(tmp_path: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run `rigel ui` after some code of the test."""
    (tmp_path / "kubeconfig").write_text(KUBECONFIG % NO_ONE)
    main = f"import sys\n{code}\nfrom rigel_k8s.cli.main import main\nmain({['ui', *words]!r})"
    return subprocess.run(
        [sys.executable, "-c", main],
        cwd=tmp_path,
        env={**os.environ, "KUBECONFIG": str(tmp_path / "kubeconfig")},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_port_that_is_taken_is_named(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = run(tmp_path, "pass", "demo", "--no-browser", "--port", str(port))
    assert done.returncode == 2
    assert f"cannot listen on 127.0.0.1:{port}: Address already in use" in done.stderr

"""Stacks of a Ditto: fetched when they are deployed, with a secret that goes nowhere else."""

from __future__ import annotations

import base64
import json
import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.cli.main import run
from rigel_k8s.commands import rigelfiles
from rigel_k8s.commands.targets import job_of, read_jobs
from rigel_k8s.errors import ProblemsError, RigelK8sError, UserError
from rigel_k8s.jobs.runner import prepare_job
from rigel_k8s.rigelfile import load
from rigel_k8s.settings import Settings
from rigel_k8s.system.trust import trust
from rigel_muto import ditto as http
from rigel_muto.ditto import Access
from rigel_muto.opening import Twin
from rigel_muto.remarks import NotFound, Unreadable
from tests.support.http_server import Exchange, HttpServer, serving

SECRET = "s3cret"


def thing(identifier: str, node: dict[str, Any], *references: str) -> dict[str, Any]:
    properties = {"node": [node], "stack": [{"thingId": name} for name in references]}
    return {"thingId": identifier, "features": {"stack": {"properties": properties}}}


def node(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "pkg": "demo", "exec": name, **more}


THINGS: dict[str, Any] = {
    "org:robot": thing("org:robot", node("talker", args="$(dirname)/a"), "org:base"),
    "org:base": thing("org:base", node("wheels")),
    "org:car": {"thingId": "org:car", "features": {"telemetry": {"properties": {}}}},
}


def answer(exchange: Exchange) -> None:
    """Answer as Ditto does: 404 for what is unknown, or not for this user."""
    name = exchange.request_.path.removeprefix("/api/2/things/")
    if name in THINGS:
        exchange.say(200, THINGS[name])
    else:
        exchange.say(404, {"status": 404, "error": "things:thing.notfound"})


@pytest.fixture
def ditto() -> Iterator[HttpServer]:
    with serving(answer) as server:
        yield server


@pytest.fixture
def rigelfile(tmp_path: Path) -> Callable[..., Settings]:
    """Write a Rigelfile with a stack, and return settings that name it."""

    def write(**muto: Any) -> Settings:
        job = {"image": "robot:1", "muto": muto, "deployment_name": "robot"}
        deploy = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}
        text = json.dumps({"application": {"distro": "noetic"}, "jobs": {"deploy": deploy}})
        (tmp_path / "Rigelfile").write_text(text)
        return Settings(rigelfile=tmp_path / "Rigelfile")

    return write


def test_a_stack_and_what_it_refers_to_are_fetched_once(
    ditto: HttpServer, rigelfile: Callable[..., Settings]
) -> None:
    """By its id, for all that a command does with the job."""
    made = job_of(rigelfile(stack="org:robot", twin_url=ditto.url), None)
    assert list(made.options.nodes) == ["wheels", "talker"]
    assert ditto.list_requests() == ["GET /api/2/things/org:robot", "GET /api/2/things/org:base"]
    assert f"{ditto.url}/api/2/things/org:robot:1:" in made.warnings.texts[0]


def test_a_things_url_is_refused_with_what_replaces_it(rigelfile: Callable[..., Settings]) -> None:
    settings = rigelfile(stack="https://ditto/api/2/things/org:base")
    (found,) = rigelfiles.check(settings).findings
    assert "write its id, and what stands before /api/2/things as `twin_url`" in found.message


def test_files_come_before_the_ditto(
    ditto: HttpServer, rigelfile: Callable[..., Settings], tmp_path: Path
) -> None:
    """What a stack in a file refers to is found in both."""
    stack = {"stackId": "org:local", "node": [], "stack": [{"thingId": "org:base"}]}
    (tmp_path / "stack.json").write_text(json.dumps(stack))
    settings = rigelfile(stack="stack.json", twin_url=ditto.url)
    assert list(job_of(settings, None).options.nodes) == ["wheels"]
    own = {"stackId": "org:base", "node": [node("own_wheels")]}
    (tmp_path / "base.json").write_text(json.dumps(own))
    assert list(job_of(settings, None).options.nodes) == ["own_wheels"]
    assert len(ditto.requests) == 1


def test_looking_asks_no_ditto(ditto: HttpServer, rigelfile: Callable[..., Settings]) -> None:
    """`rigel check` says that it did not look; `rigel logs` and its like need no stack."""
    settings = rigelfile(stack="org:robot", twin_url=ditto.url)
    (found,) = rigelfiles.check(settings).findings
    assert (found.kind, found.severity) == ("not-fetched", "warning")
    jobs = read_jobs(Settings(settings.rigelfile))
    assert str(jobs.read_names(jobs.choose("deploy")).deployment_name) == "robot"
    assert ditto.requests == []


def test_a_run_knows_the_nodes_before_it_begins(
    ditto: HttpServer, rigelfile: Callable[..., Settings]
) -> None:
    """So a stack that is wrong stops it, and warnings come first; it is fetched once."""
    settings = rigelfile(stack="org:robot", twin_url=ditto.url)
    (warning,) = prepare_job(load(settings.rigelfile), "deploy", settings).warnings
    assert "$(dirname) is none of $(find PACKAGE)" in warning
    assert len(ditto.requests) == 2
    with pytest.raises(ProblemsError, match="has 1 problem"):
        prepare_job(
            load(rigelfile(stack="org:car", twin_url=ditto.url).rigelfile), "deploy", settings
        )


def test_a_secret_is_sent_only_where_the_directory_is_trusted(
    ditto: HttpServer,
    rigelfile: Callable[..., Settings],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A Rigelfile of unknown origin cannot send the user's environment to its author."""
    monkeypatch.setenv("DITTO_TOKEN", SECRET)
    settings = rigelfile(stack="org:base", twin_url=ditto.url, token="DITTO_TOKEN")
    with pytest.raises(ProblemsError) as refused:
        job_of(settings, None)
    assert "untrusted" in refused.value.details[0]
    assert SECRET not in refused.value.details[0]
    assert ditto.requests == []
    trust(tmp_path)
    job_of(settings, None)
    assert [r.headers["Authorization"] for r in ditto.requests] == [f"Bearer {SECRET}"]


def test_a_user_logs_in_with_a_password(ditto: HttpServer) -> None:
    access = Access(user="me", password="PASSWORD")
    Twin(ditto.url, access, {"PASSWORD": SECRET}, {}).find("org:base")
    _, _, words = ditto.requests[0].headers["Authorization"].partition("Basic ")
    assert base64.b64decode(words).decode() == f"me:{SECRET}"


def test_a_secret_goes_neither_unencrypted_nor_to_another_server(ditto: HttpServer) -> None:
    """Plain HTTP is for this machine alone; a redirection is an error, not followed."""
    access = Access(token="TOKEN")
    far = Twin("http://ditto.invalid", access, {"TOKEN": SECRET}, {})
    with pytest.raises(UserError, match="would not be encrypted"):
        far.find("org:base")
    elsewhere = f"{ditto.url}/api/2/things/org:base"
    first = serving(lambda e: e.say(302, Location=elsewhere))
    with first as server, pytest.raises(RigelK8sError, match="answered 302"):
        Twin(server.url, access, {"TOKEN": SECRET}, {}).find("org:base")
    assert ditto.requests == []


def test_a_variable_that_is_not_set_is_named(ditto: HttpServer) -> None:
    with pytest.raises(UserError, match="the environment variable TOKEN is not set"):
        Twin(ditto.url, Access(token="TOKEN"), {}, {}).find("org:base")


@pytest.mark.parametrize("identifier", ["org:nowhere", "../../2/things/org:base"])
def test_a_thing_that_is_not_there_is_not_found(ditto: HttpServer, identifier: str) -> None:
    """An id is one part of the path, whatever stands in it."""
    with pytest.raises(NotFound, match="there is no thing"):
        Twin(ditto.url, Access(), {}, {}).find(identifier)


def test_a_thing_without_a_stack_is_reported_at_its_place(ditto: HttpServer) -> None:
    with pytest.raises(Unreadable, match=r"features\.stack\.properties"):
        Twin(ditto.url, Access(), {}, {}).find("org:car")


@pytest.mark.parametrize(
    ("say", "message"),
    [
        (lambda e: e.say(401), "refuses these credentials"),
        (lambda e: e.say(500), "answered 500"),
        (lambda e: e.say(200, b"x" * (http.MOST_BYTES + 1)), "has more than"),
        (lambda e: e.say(200, b"x", Content_Length="5"), "cannot be reached"),
    ],
)
def test_a_ditto_that_gives_no_stack_says_why(
    say: Callable[[Exchange], None], message: str
) -> None:
    with serving(say) as server, pytest.raises(RigelK8sError, match=message):
        Twin(server.url, Access(), {}, {}).find("org:base")


def test_nobody_at_the_url_is_an_error() -> None:
    with pytest.raises(RigelK8sError, match="cannot be reached"):
        Twin("http://127.0.0.1:9", Access(), {}, {}).find("org:base")


def test_convert_fetches_what_the_user_names(
    ditto: HttpServer, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command line is the user's own word, so it needs no trust."""
    monkeypatch.setenv("TOKEN", SECRET)
    words = ["muto", "convert", "org:robot", "--twin-url", ditto.url, "--token", "TOKEN"]
    assert run(words, "rigel") == 0
    captured = capsys.readouterr()
    assert "        wheels:\n" in captured.out
    assert SECRET not in captured.out + captured.err
    assert {r.headers["Authorization"] for r in ditto.requests} == {f"Bearer {SECRET}"}


@pytest.mark.parametrize(
    "muto",
    [
        {"stack": "org:a", "twin_url": "ditto"},
        {"stack": "org:a", "twin_url": "https://"},
        {"stack": "org:a", "twin_url": "https://[ditto"},
        {"stack": "org:a", "twin_url": "https://me:secret@ditto"},
        {"stack": "org:a", "twin_url": "https://ditto", "user": "me"},
        {"stack": "org:a", "twin_url": "https://d", "user": "me", "password": "P", "token": "T"},
        {"stack": "org:a", "token": "TOKEN"},
    ],
)
def test_options_that_contradict_each_other_are_refused(
    rigelfile: Callable[..., Settings], muto: dict[str, str]
) -> None:
    (found,) = rigelfiles.check(rigelfile(**muto)).findings
    assert found.kind == "bad-value"


def test_certificate_authorities_are_loaded_once(
    ditto: HttpServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not for each of a session's requests: it takes longer than one."""
    loaded: list[object] = []

    def load_default_certs(self: ssl.SSLContext, purpose: object = None) -> None:
        loaded.append(self)

    monkeypatch.setattr(ssl.SSLContext, "load_default_certs", load_default_certs)
    twin = Twin(ditto.url, Access(), {}, {})
    for name in ("org:robot", "org:base"):
        twin.find(name)
    assert len(ditto.requests) == 2
    assert len(loaded) == 1


@pytest.mark.parametrize("part", ["head", "body", "endless body"])
def test_a_ditto_that_sends_one_byte_after_the_other_is_not_waited_for(
    part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither of head and body; each byte would begin a new wait of five seconds."""
    monkeypatch.setattr(http, "DEADLINE", 0.6)
    head = b"HTTP/1.1 200 OK\r\n"
    length = b"" if part == "endless body" else b"Content-Length: 1000\r\n"

    def drip(exchange: Exchange) -> None:
        exchange.close_connection = True
        text = b"x" * 1000
        if part == "head":
            text = head + text
        else:
            exchange.wfile.write(head + length + b"\r\n")
        with suppress(OSError):
            for one in text:
                exchange.wfile.write(bytes([one]))
                time.sleep(0.1)

    began = time.monotonic()
    with serving(drip) as server:
        twin = Twin(server.url, Access(), {}, {})
        with pytest.raises(RigelK8sError, match=r"did not answer within 0\.6 s"):
            twin.find("org:base")
        assert time.monotonic() - began < 50  # of 100

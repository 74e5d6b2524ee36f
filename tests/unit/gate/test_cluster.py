"""The one object of the cluster, by an API server that answers over TLS as Kubernetes does."""

from __future__ import annotations

import base64
import shutil
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_gate.cluster import KEY, WRITER, ClusterObject, NotKept, Overtaken
from tests.support.http_server import Exchange, HttpServer, serving

pytestmark = pytest.mark.skipif(not shutil.which("openssl"), reason="needs openssl")


class Server:
    """An API server with one Secret; each change makes a new version of it.

    Attributes:
        before: is called with each request before it is answered.
        broken: (status, body) that is answered instead.
    """

    def __init__(self) -> None:
        self.secret: dict[str, Any] = {"metadata": {"name": "memory", "resourceVersion": "1"}}
        self.disturbed = 0
        self.broken: tuple[int, bytes] | None = None

    def change(self, meta: dict[str, Any], data: dict[str, str] | None = None) -> None:
        """Change the Secret, as anyone may."""
        own = self.secret["metadata"]
        own.setdefault("annotations", {}).update(meta.get("annotations", {}))
        own["resourceVersion"] = str(int(own["resourceVersion"]) + 1)
        if data:
            self.secret.setdefault("data", {}).update(data)

    def answer(self, exchange: Exchange) -> None:
        request = exchange.request_
        assert request.path == "/api/v1/namespaces/robots/secrets/memory"
        assert request.headers["Authorization"] == "Bearer secret token"
        if self.broken:
            exchange.say(*self.broken)
            return
        if request.method == "PATCH":
            assert request.headers["Content-Type"] == "application/merge-patch+json"
            assert request.query == {"fieldManager": ["rigel-gate"]}
            if self.disturbed:
                self.disturbed -= 1
                self.change({"annotations": {"someone": "else"}})
            change = request.json
            if change["metadata"]["resourceVersion"] != self.secret["metadata"]["resourceVersion"]:
                exchange.say(409, {"message": "the object has been modified"})
                return
            self.change(change["metadata"], change.get("data"))
        exchange.say(200, self.secret)

    @property
    def kept(self) -> str | None:
        text = self.secret.get("data", {}).get(KEY)
        return base64.b64decode(text).decode() if text else None


@pytest.fixture(scope="module")
def account(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A service account's folder; its authority is the server's own certificate."""
    folder = tmp_path_factory.mktemp("account")
    made = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1"
    made += f" -subj /CN=api -addext subjectAltName=IP:127.0.0.1 -keyout {folder}/key"
    subprocess.run([*made.split(), "-out", f"{folder}/ca.crt"], check=True, capture_output=True)
    (folder / "namespace").write_text("robots\n")
    (folder / "token").write_text("secret token\n")
    return folder


@pytest.fixture
def server() -> Server:
    return Server()


@pytest.fixture
def http(account: Path, server: Server, monkeypatch: pytest.MonkeyPatch) -> Iterator[HttpServer]:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(account / "ca.crt", account / "key")
    with serving(server.answer, tls=context) as found:
        monkeypatch.setenv("KUBERNETES_SERVICE_HOST", "127.0.0.1")
        monkeypatch.setenv("KUBERNETES_SERVICE_PORT", str(found.server_port))
        yield found


@pytest.fixture
def place(account: Path, http: HttpServer) -> ClusterObject:
    return ClusterObject("memory", "pod-a", account)


@pytest.mark.programs
def test_an_object_that_rigel_has_just_made_is_empty(place: ClusterObject, server: Server):
    """It has no data at all; from now on this pod writes."""
    assert place.read(takes_over=True) is None
    assert server.secret["metadata"]["annotations"][WRITER] == "pod-a"


def test_what_is_kept_is_read_by_the_next_pod(
    place: ClusterObject, server: Server, account: Path, http: HttpServer
):
    place.read(takes_over=True)
    place.write("one")
    place.write("two")
    assert server.kept == "two"
    assert ClusterObject("memory", "pod-b", account).read(takes_over=True) == "two"
    assert server.secret["metadata"]["annotations"][WRITER] == "pod-b"
    assert {request.method for request in http.requests} == {"GET", "PATCH"}


def test_a_change_by_someone_else_is_no_other_gates(place: ClusterObject, server: Server):
    """`rigel` deploys again and sets labels: the gate reads the version and writes again."""
    place.read(takes_over=True)
    server.disturbed = 2
    place.write("kept")
    assert server.kept == "kept"
    assert server.secret["metadata"]["annotations"]["someone"] == "else"


def test_a_change_while_the_gate_begins_is_tried_again(place: ClusterObject, server: Server):
    """Another gate may still be writing: who starts later wins."""
    server.change({"annotations": {WRITER: "pod-0"}})
    server.disturbed = 1
    place.read(takes_over=True)
    assert server.secret["metadata"]["annotations"][WRITER] == "pod-a"


def test_a_gate_of_another_pod_that_has_begun_is_not_written_over(
    place: ClusterObject, server: Server, account: Path
):
    place.read(takes_over=True)
    place.write("old")
    newer = ClusterObject("memory", "pod-b", account)
    newer.read(takes_over=True)
    with pytest.raises(Overtaken, match="the gate of pod pod-b writes now"):
        place.write("too late")
    newer.write("new")
    assert server.kept == "new"


def test_an_object_that_changes_all_the_time_is_given_up(place: ClusterObject, server: Server):
    """For now; the next try comes with the next pause."""
    place.read(takes_over=True)
    server.disturbed = 1000
    with pytest.raises(NotKept, match="another program keeps changing it"):
        place.write("kept")
    server.disturbed = 0
    place.write("kept")
    assert server.kept == "kept"


@pytest.mark.parametrize(("status", "word"), [(403, "forbidden"), (404, "not found"), (500, "")])
def test_another_answer_is_reported_with_its_words(
    place: ClusterObject, server: Server, status: int, word: str
):
    server.broken = (status, word.encode())
    with pytest.raises(NotKept, match=f"the API server answered {status}: {word}"):
        place.read(takes_over=True)


def test_an_answer_that_is_no_object_is_reported(place: ClusterObject, server: Server):
    """A proxy in between, perhaps."""
    server.broken = (200, b"<html>")
    with pytest.raises(NotKept, match="the API server answered 200: <html>"):
        place.read(takes_over=True)


def test_an_api_server_that_is_away_is_reported(account: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("KUBERNETES_SERVICE_HOST", "127.0.0.1")
    monkeypatch.setenv("KUBERNETES_SERVICE_PORT", "1")
    with pytest.raises(NotKept, match=r"cannot reach the API server at 127.0.0.1:1: "):
        ClusterObject("memory", "pod-a", account).read(takes_over=True)


def test_an_api_server_that_hangs_up_is_reported(place: ClusterObject, http: HttpServer):
    http.answer = lambda exchange: exchange.hang_up()
    with pytest.raises(NotKept, match="cannot reach"):
        place.read(takes_over=True)


@pytest.mark.programs
def test_another_authoritys_server_gets_no_token(account: Path, http: HttpServer, tmp_path: Path):
    made = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 1"
    made += f" -subj /CN=other -keyout {tmp_path}/key -out {tmp_path}/ca.crt"
    subprocess.run(made.split(), check=True, capture_output=True)
    for name in ("namespace", "token"):
        shutil.copy(account / name, tmp_path)
    with pytest.raises(NotKept, match="certificate verify failed"):
        ClusterObject("memory", "pod-a", tmp_path).read(takes_over=True)
    assert http.requests == []


def test_a_service_account_that_cannot_be_read_is_reported(
    account: Path, http: HttpServer, tmp_path: Path
):
    """The kubelet may not have made it yet, or takes it away with the pod."""
    for name in ("namespace", "token"):
        shutil.copy(account / name, tmp_path)
    place = ClusterObject("memory", "pod-a", tmp_path)
    with pytest.raises(NotKept, match="the pod's service account cannot be read: "):
        place.read(takes_over=True)
    (tmp_path / "token").unlink()
    with pytest.raises(NotKept, match="the pod's service account cannot be read: "):
        place.read(takes_over=True)


def test_a_token_that_the_kubelet_has_renewed_is_used(
    place: ClusterObject, account: Path, http: HttpServer
):
    """It is valid for an hour only."""
    (account / "token").write_text("renewed")
    try:
        http.answer = lambda exchange: exchange.say(401, {})
        with pytest.raises(NotKept):
            place.read(takes_over=True)
        assert http.requests[-1].headers["Authorization"] == "Bearer renewed"
    finally:
        (account / "token").write_text("secret token\n")

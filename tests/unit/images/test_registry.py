"""The registry protocol against a small HTTP server: what Debian's docker-registry cannot show.

The real registry is in tests/cluster/test_images.py.
"""

from __future__ import annotations

import base64
import hashlib
import json
import socket
import ssl
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.images import registry as module
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.images.registry import (
    _Patience,
    _proxy_of,
    _Registry,
    _Unclear,
    challenge,
    find_architectures,
    log_in,
    look_up,
)
from tests.support.digests import resolve_digest
from tests.support.tag_registry import serve_tags

MANIFEST = b'{"schemaVersion": 2}'
DIGEST = f"sha256:{hashlib.sha256(MANIFEST).hexdigest()}"
INDEX, IMAGE, CONFIG = (f"sha256:{digit * 64}" for digit in "123")
BASIC = "Basic " + base64.b64encode(b"me:secret").decode()
Request = tuple[str, str, str]


class Handler(BaseHTTPRequestHandler):
    """A registry that wants a token, and its token server."""

    protocol_version = "HTTP/1.1"
    server: Registry

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""

    def do_HEAD(self) -> None:
        self.answer()

    def do_GET(self) -> None:
        self.answer()

    def answer(self) -> None:
        given = self.headers.get("Authorization", "")
        self.server.seen.append((self.command, self.path, given))
        if self.path.startswith("/token"):
            good = given in ("", BASIC)
            body = json.dumps({"token": f"for {given}"} if good else {}).encode()
            self.send(200 if good else 401, body)
        elif not given and self.server.realm is not None:
            realm = f'Bearer realm="{self.server.realm}",service="here",scope="x"'
            self.send(401, b"", {"WWW-Authenticate": realm})
        elif self.path in ("/v2/", "/v2/team/app/manifests/1"):
            headers = {"Docker-Content-Digest": DIGEST} if self.server.tells else {}
            self.send(200, MANIFEST, headers)
        elif self.path in self.server.blobs:
            self.send(200, json.dumps(self.server.blobs[self.path]).encode())
        else:
            self.send(404, b"")

    def send(self, status: int, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for name, value in {**(headers or {}), "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


class Registry(ThreadingHTTPServer):
    """Where it listens, how it behaves, what it was asked."""

    realm: str | None
    tells = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.name = f"127.0.0.1:{self.server_address[1]}"
        self.realm = f"http://{self.name}/token?a=b"
        self.seen: list[Request] = []
        self.blobs: dict[str, object] = {}


@pytest.fixture
def registry() -> Iterator[Registry]:
    server = Registry()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_token_is_fetched_for_the_repository(registry: Registry) -> None:
    """The token server is asked for pulling this repository, as the user, and nobody else is."""
    me = RegistryCredentials(registry.name, "me", "secret")
    assert resolve_digest(f"{registry.name}/team/app:1", me) == DIGEST
    (_, path, given), (*_, last) = registry.seen[-2:]
    assert path == "/token?a=b&service=here&scope=repository%3Ateam%2Fapp%3Apull"
    assert (given, last) == (BASIC, f"Bearer for {BASIC}")


def test_an_index_names_the_machines_that_an_image_runs_on(registry: Registry) -> None:
    """Attestations, which are listed beside the images, are for no machine."""
    platforms = [("linux", "amd64"), ("linux", "arm64"), ("unknown", "unknown"), ("windows", "x")]
    listed = [{"platform": {"os": os, "architecture": name}} for os, name in platforms]
    registry.blobs[f"/v2/team/app/manifests/{INDEX}"] = {"manifests": listed}
    image = f"{registry.name}/team/app:1@{INDEX}"
    assert find_architectures(image) == {"amd64", "arm64"}


def test_an_image_by_itself_names_its_machine_in_its_configuration(registry: Registry) -> None:
    """That costs one request more."""
    registry.blobs[f"/v2/team/app/manifests/{IMAGE}"] = {"config": {"digest": CONFIG}}
    registry.blobs[f"/v2/team/app/blobs/{CONFIG}"] = {"os": "linux", "architecture": "arm64"}
    me = RegistryCredentials(registry.name, "me", "secret")
    assert find_architectures(f"{registry.name}/team/app@{IMAGE}", me) == {"arm64"}


@pytest.mark.parametrize("manifest", [None, [], {}, {"manifests": []}, {"config": {}}])
def test_what_a_registry_does_not_say_is_unknown(registry: Registry, manifest: object) -> None:
    """Nothing is refused for it."""
    registry.blobs[f"/v2/team/app/manifests/{IMAGE}"] = manifest
    assert find_architectures(f"{registry.name}/team/app@{IMAGE}") == frozenset()
    assert find_architectures(f"{registry.name}/team/other@{IMAGE}") == frozenset()


def test_public_images_need_no_credentials(registry: Registry) -> None:
    """Without credentials the token is asked for anonymously."""
    assert resolve_digest(f"{registry.name}/team/app:1") == DIGEST
    assert registry.seen[-2][2] == ""


def test_a_registry_that_does_not_tell_the_digest_is_believed_its_manifest(
    registry: Registry,
) -> None:
    """Without the header the digest is that of the manifest's bytes."""
    registry.realm, registry.tells = None, False
    assert resolve_digest(f"{registry.name}/team/app:1") == DIGEST


def test_an_image_with_a_digest_is_its_own_answer(registry: Registry) -> None:
    """Nobody is asked about a reference that has a digest."""
    assert resolve_digest(f"{registry.name}/team/app:1@{DIGEST}") == DIGEST
    assert registry.seen == []


def wrong_password(registry: Registry) -> str | None:
    wrong = RegistryCredentials(registry.name, "me", "wrong")
    return resolve_digest(f"{registry.name}/team/app:1", wrong)


def unknown_scheme(registry: Registry) -> str | None:
    registry.realm = "no url"
    return resolve_digest(f"{registry.name}/team/app:1")


@pytest.mark.parametrize(
    "ask",
    [
        wrong_password,
        unknown_scheme,
        lambda registry: resolve_digest(f"{registry.name}/team/app:2"),
        lambda _: resolve_digest("127.0.0.1:1/team/app:1"),
    ],
)
def test_none_where_it_cannot_tell(
    registry: Registry, ask: Callable[[Registry], str | None]
) -> None:
    """A refusal, a missing tag and silence give None, and no error."""
    assert ask(registry) is None


def test_an_image_that_its_registry_does_not_have_is_told_from_one_that_is_not_known() -> None:
    """The first is an error before a deploy; of the second nothing is said."""
    with serve_tags() as server:
        missing, away = f"{server.host}/app:2", "127.0.0.1:1/app:1"
        assert look_up([missing, away]).unknown == {missing}


def test_nobody_is_asked_twice_where_nobody_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    """A private registry that is away costs one wait for a connection, not two."""
    monkeypatch.setattr(_Registry, "_send", lambda *_: pytest.fail("it was asked"))
    assert resolve_digest("127.0.0.1:1/team/app:1") is None


@contextmanager
def silence(registries: int) -> Iterator[tuple[list[str], Callable[[], int]]]:
    """Yield names of registries that accept connections and never answer, and how many came."""
    with ExitStack() as stack:
        sockets = [
            stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(registries)
        ]
        accepted: list[socket.socket] = []

        def count() -> int:
            for listener in sockets:
                listener.setblocking(False)
                with suppress(BlockingIOError):
                    while True:
                        accepted.append(stack.enter_context(listener.accept()[0]))
            return len(accepted)

        yield [f"127.0.0.1:{listener.getsockname()[1]}" for listener in sockets], count


def look_up_in_time(
    registry: Registry,
    images: list[str],
    monkeypatch: pytest.MonkeyPatch,
    before: threading.Event | None = None,
) -> Mapping[str, str]:
    """Look images up; this registry has a minute for each answer, silent ones are soon given up.

    Args:
        before: what happens before any other registry is asked.
    """

    def connect(credentials: RegistryCredentials, timeout: float) -> _Registry:
        if credentials.server == registry.name:
            return _Registry(credentials, 60)
        assert before is None or before.wait(60)
        return _Registry(credentials, timeout)

    monkeypatch.setattr(module, "_Registry", connect)
    return look_up(images, timeout=0.1).digests


def test_a_silent_registry_is_not_asked_for_each_of_its_images(
    registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is known after a few requests is not waited for a thousand times; others are asked."""
    good = f"{registry.name}/team/app:1"
    with silence(1) as ([silent], count):
        images = [f"{silent}/team/app:{number}" for number in range(1000)]
        assert look_up_in_time(registry, [*images, good], monkeypatch) == {good: DIGEST}
        assert count() < 50  # two connections for each request: TLS, then plain HTTP


def test_silent_registries_are_not_all_waited_for(
    registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file may name a thousand of them; one that has answered is asked until the end."""
    good, missing = (f"{registry.name}/team/app:{tag}" for tag in "12")
    answered, note = threading.Event(), _Patience.note

    def note_and_tell(self: _Patience, name: str, **words: bool) -> None:
        note(self, name, **words)
        answered.set()

    monkeypatch.setattr(_Patience, "note", note_and_tell)
    with silence(100) as (names, count):
        images = [good, *(f"{name}/team/app:1" for name in names), missing]
        assert look_up_in_time(registry, images, monkeypatch, answered) == {good: DIGEST}
        assert "/v2/team/app/manifests/2" in {path for _, path, _ in registry.seen}
        assert count() < 80  # of 200


def test_without_a_port_plain_http_has_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody on 443 says nothing about 80."""
    asked: list[str] = []

    def send(_: _Registry, method: str, url: str, headers: object) -> None:
        asked.append(f"{method} {url}")
        raise _Unclear("no")

    monkeypatch.setattr(_Registry, "_send", send)
    assert resolve_digest("127.83.21.7/team/app:1") is None
    assert asked == ["HEAD http://127.83.21.7/v2/team/app/manifests/1"]


@pytest.mark.programs
@pytest.mark.parametrize("trusted", [True, False])
def test_a_private_registry_with_tls_is_asked_with_tls(
    registry: Registry,
    tmp_path: Path,
    trusted: bool,  # noqa: FBT001 - a case's value
) -> None:
    """Its certificate counts as ever; without it nothing is asked in the clear instead."""
    names = "-subj /CN=127.0.0.1 -addext subjectAltName=IP:127.0.0.1"
    key = f"-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -keyout {tmp_path}/key"
    made = f"openssl req -x509 {key} -out {tmp_path}/pem {names}"
    subprocess.run(made.split(), check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "pem", tmp_path / "key")
    registry.realm = None
    registry.socket = context.wrap_socket(registry.socket, server_side=True)
    credentials = RegistryCredentials(registry.name, insecure=trusted)
    found = resolve_digest(f"{registry.name}/team/app:1", credentials)
    assert found == (DIGEST if trusted else None)
    assert len(registry.seen) == int(trusted)


@pytest.mark.parametrize("name", ["ghcr.io", "docker.io", "8.8.8.8:5000", "robot.local:5000"])
def test_a_registry_of_others_is_asked_with_tls_alone(name: str) -> None:
    """Who is neither here nor in a private network is asked in the clear if `insecure` says so."""
    bases = _Registry(RegistryCredentials(name), 1)._bases()
    assert bases == [f"https://{'registry-1.docker.io' if name == 'docker.io' else name}"]


def test_good_credentials_log_in(registry: Registry) -> None:
    """log_in is true where the registry wanted credentials and took these."""
    assert log_in(RegistryCredentials(registry.name, "me", "secret"))


def test_a_registry_without_users_logs_nobody_in(registry: Registry) -> None:
    """log_in is false where the registry asks for none."""
    registry.realm = None
    assert not log_in(RegistryCredentials(registry.name, "me", "secret"))


def test_wrong_credentials_are_refused(registry: Registry) -> None:
    """The error names registry and user, not the password."""
    with pytest.raises(RigelK8sError, match=f'{registry.name} refuses user "me"') as caught:
        log_in(RegistryCredentials(registry.name, "me", "wrong"))
    assert "wrong" not in f"{caught.value} {caught.value.hint} {caught.value.details}"
    assert caught.value.exit_code == 1


def test_a_registry_that_is_not_there_is_told() -> None:
    """The error says what cannot be reached."""
    with pytest.raises(RigelK8sError, match=r"registry 127\.0\.0\.1:1: .*refused"):
        log_in(RegistryCredentials("127.0.0.1:1", "me", "secret"))


def test_no_password_goes_to_an_unencrypted_address_of_a_network() -> None:
    """A private address is asked over plain HTTP; a password takes `insecure` as well."""
    me = RegistryCredentials("10.0.0.1:5000", "me", "secret")
    with pytest.raises(_Unclear, match="insecure: true"):
        _Registry(me, 1)._authorize("http://10.0.0.1:5000", "Basic", scope=None)


def test_no_password_goes_to_an_unencrypted_token_server() -> None:
    """A registry with TLS cannot make us send the password over plain HTTP."""
    me = RegistryCredentials("host", "me", "secret")
    header = 'Bearer realm="http://elsewhere/token"'
    with pytest.raises(_Unclear, match="not encrypted"):
        _Registry(me, 1)._authorize("https://host", header, scope=None)


def test_challenges_are_read() -> None:
    """Quoted values with commas and escapes, and bare ones, are read."""
    header = r'Bearer realm="https://a/b",scope="repository:x:pull,push", error="a \"b\"",n=1'
    assert challenge(header) == (
        "bearer",
        {"realm": "https://a/b", "scope": "repository:x:pull,push", "error": 'a "b"', "n": "1"},
    )


@pytest.mark.parametrize(
    ("url", "no_proxy", "proxy"),
    [
        ("https://registry.example.com", "", "http://p:3128"),
        ("https://registry.example.com", ".example.com", None),
        ("https://10.1.2.3:5000", "10.0.0.0/8", None),
        ("http://registry.example.com", "", None),
        ("https://127.0.0.1:5000", "", None),
    ],
)
def test_the_environments_proxy_is_read_as_for_a_cluster(
    monkeypatch: pytest.MonkeyPatch, url: str, no_proxy: str, proxy: str | None
) -> None:
    """NO_PROXY may name networks; a proxy without a scheme speaks HTTP."""
    for name in ("http_proxy", "HTTP_PROXY", "https_proxy", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HTTPS_PROXY", "p:3128")
    monkeypatch.setenv("NO_PROXY", no_proxy)
    assert _proxy_of(url) == proxy

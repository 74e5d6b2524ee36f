"""What a client's TLS accepts, and that threads may share it."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import urllib3

from rigel_k8s.system.tls import trust
from tests.support.certificates import AUTHORITY, SERVER, Authority
from tests.support.http_server import Exchange, serving

pytestmark = pytest.mark.programs


@contextmanager
def server_of(*pems: Path, protocols: tuple[str, ...] = ()) -> Iterator[str]:
    """Give the URL of a server that shows the first certificate, and the others with it."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    chain = pems[0].with_suffix(".chain")
    chain.write_text("".join(pem.read_text() for pem in pems))
    context.load_cert_chain(chain, pems[0].with_suffix(".key"))
    context.set_alpn_protocols(list(protocols))

    def answer(exchange: Exchange) -> None:
        exchange.say(200, (exchange.connection.selected_alpn_protocol() or "").encode())

    with serving(answer, tls=context) as server:
        yield server.url


def ask(url: str, context: ssl.SSLContext) -> str:
    """Return the protocol that a new connection has."""
    with urllib3.PoolManager(ssl_context=context, retries=False) as http:
        return http.request("GET", url).data.decode()


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


def test_an_authority_without_key_identifiers_is_accepted(authority: Authority) -> None:
    """As kubectl does; Python 3.13's own settings refuse it, and with it MicroK8s and EKS."""
    root = authority.make("root", AUTHORITY)
    server = authority.make("server", SERVER, by="root")
    with server_of(server) as url:
        ask(url, trust(root.read_text()))


def test_an_authority_that_another_one_has_signed_is_enough(authority: Authority) -> None:
    """A kubeconfig may name the one in between alone."""
    authority.make("root", AUTHORITY)
    between = authority.make("between", AUTHORITY, by="root")
    server = authority.make("server", SERVER, by="between")
    with server_of(server) as url:
        ask(url, trust(between.read_text()))


def test_other_authorities_and_names_are_refused(authority: Authority) -> None:
    """What is accepted above is checked all the same."""
    root = authority.make("root", AUTHORITY)
    other = authority.make("other", AUTHORITY)
    server = authority.make("server", SERVER, by="root")
    elsewhere = authority.make("elsewhere", "subjectAltName=DNS:elsewhere\n", by="root")
    with server_of(server) as url, pytest.raises(urllib3.exceptions.SSLError):
        ask(url, trust(other.read_text()))
    with server_of(server) as url, pytest.raises(urllib3.exceptions.SSLError):
        ask(url, trust())
    with server_of(elsewhere) as url, pytest.raises(urllib3.exceptions.SSLError):
        ask(url, trust(root.read_text()))


def test_a_connection_changes_nothing_for_other_threads(authority: Authority) -> None:
    """urllib3 sets the protocols for each connection, while another thread connects with them."""
    root = authority.make("root", AUTHORITY)
    server = authority.make("server", SERVER, by="root")
    context = trust(root.read_text())
    with server_of(server, protocols=("other", "http/1.1")) as url:
        place = urlsplit(url)
        for _ in range(2):
            with (
                socket.create_connection((place.hostname, place.port)) as plain,
                context.wrap_socket(plain, server_hostname=place.hostname) as connection,
            ):
                assert connection.selected_alpn_protocol() == "http/1.1"
            context.set_alpn_protocols(["other"])

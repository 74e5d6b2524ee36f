"""Requests to a Ditto: over HTTP, with a secret that is sent nowhere else."""

from __future__ import annotations

import base64
import json
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, urlsplit

import attrs

from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.rigelfile.limits import MOST_BYTES
from rigel_k8s.system.tls import environment_proxy, is_loopback

if TYPE_CHECKING:
    import ssl

    import urllib3

#: Where Ditto has its things.
THINGS = "/api/2/things/"
#: Seconds for a connection and for each answer's next part; for the whole request.
PATIENCE, DEADLINE = 5.0, 30.0


@attrs.frozen
class Access:
    """How to log in: the names of the environment's variables that hold the secrets."""

    token: str | None = None
    user: str | None = None
    password: str | None = None

    @property
    def secret(self) -> str | None:
        """The variable that is sent; None: none."""
        return self.token or self.password

    def header(self, environ: Mapping[str, str]) -> str | None:
        """Return the header Authorization, None for none.

        Raises:
            UserError: a variable is not set.
        """
        if self.token:
            return f"Bearer {_read_secret(self.token, environ)}"
        if self.user and self.password:
            secret = f"{self.user}:{_read_secret(self.password, environ)}"
            return f"Basic {base64.b64encode(secret.encode()).decode()}"
        return None


def _read_secret(name: str, environ: Mapping[str, str]) -> str:
    value = environ.get(name, "").strip()
    if not value:
        raise UserError(
            f"the environment variable {name} is not set", hint=f"export {name}, or name another"
        )
    return value


@attrs.frozen
class Answer:
    """Ditto's answer, unless it refuses the credentials."""

    status: int
    content: bytes


@attrs.frozen
class Ditto:
    """One Ditto.

    Attributes:
        url: the part before /api/2/things.
    """

    url: str
    access: Access
    environ: Mapping[str, str] = attrs.field(repr=False)
    _authorities: ssl.SSLContext = attrs.field(init=False, repr=False, eq=False)

    @_authorities.default
    def _load_authorities(self) -> ssl.SSLContext:
        """Load them once: it takes longer than a request."""
        from rigel_k8s.system.tls import trust

        return trust()

    def url_of(self, thing: str, path: str = "") -> str:
        """Return the URL of a thing, or of a part of it."""
        return f"{self.url.rstrip('/')}{THINGS}{quote(thing, safe=':')}{path}"

    def request(
        self, method: str, url: str, body: object = None, media: str = "application/json"
    ) -> Answer:
        """Send a request and return the answer.

        Raises:
            UserError: the variable of a secret is not set, or the secret would be sent unencrypted.
            RigelK8sError: Ditto cannot be reached, or refuses the credentials.
        """
        import urllib3

        authorization = self.access.header(self.environ)
        headers = {"Accept": "application/json"}
        if authorization:
            _refuse_plain(url)
            headers["Authorization"] = authorization
        data = None if body is None else json.dumps(body).encode()
        if data is not None:
            headers["Content-Type"] = media
        client = _pool(url, self.environ, self._authorities)
        deadline = Deadline()
        try:
            with deadline.over(client.connection_from_url(url)):
                answer = client.request(
                    method, url, body=data, headers=headers, redirect=False, preload_content=False
                )
                try:
                    found = _read_answer(answer, url)
                finally:
                    answer.close()
            if deadline.is_over:
                raise RigelK8sError(f"{url} did not answer within {DEADLINE:g} s")
            return found
        except urllib3.exceptions.HTTPError as error:
            if deadline.is_over:
                raise RigelK8sError(f"{url} did not answer within {DEADLINE:g} s") from error
            reason = getattr(error, "reason", None) or error
            raise RigelK8sError(
                f"{url} cannot be reached: {reason}", hint="check twin_url and the network"
            ) from error


class Deadline:
    """Ends the connections of a request that takes too long, however slowly each byte arrives."""

    def __init__(self) -> None:
        self.is_over = False
        self._sockets: list[socket.socket] = []

    @contextmanager
    def over(self, pool: urllib3.HTTPConnectionPool) -> Iterator[None]:
        """Watch the connections that a pool makes meanwhile."""
        sockets = self._sockets

        class Connection(pool.ConnectionCls):  # type: ignore[name-defined,misc]
            def _new_conn(self) -> socket.socket:
                made: socket.socket = super()._new_conn()
                sockets.append(made.dup())  # TLS takes over the socket itself
                return made

        pool.ConnectionCls = Connection
        timer = threading.Timer(DEADLINE, self._end)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            for one in sockets:
                one.close()

    def _end(self) -> None:
        self.is_over = True
        for one in self._sockets:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


def _read_answer(answer: urllib3.BaseHTTPResponse, url: str) -> Answer:
    if answer.status in (401, 403):
        raise RigelK8sError(
            f"{url} answered {answer.status}: it refuses these credentials",
            hint="set token, or user and password, of `muto`; each names a variable",
        )
    content = b""
    for part in answer.stream(2**16):
        content += part
        if len(content) > MOST_BYTES:
            raise UserError(f"{url} has more than {MOST_BYTES} bytes")
    return Answer(answer.status, content)


def _refuse_plain(url: str) -> None:
    """Refuse to send a secret that others could read on its way."""
    parts = urlsplit(url)
    host = parts.hostname or ""
    if parts.scheme != "https" and not (host == "localhost" or is_loopback(host)):
        raise UserError(
            f"the credentials for {url} would not be encrypted", hint="use https:// in twin_url"
        )


def _pool(url: str, environ: Mapping[str, str], authorities: ssl.SSLContext) -> urllib3.PoolManager:
    """Return connections through the environment's proxy, if it has one for the URL."""
    import urllib3

    options: dict[str, Any] = {"timeout": PATIENCE, "retries": False, "ssl_context": authorities}
    proxy = environment_proxy(urlsplit(url), environ)
    return urllib3.ProxyManager(proxy, **options) if proxy else urllib3.PoolManager(**options)

"""Files from a web server: each is complete and matches its published checksum, or is not there.

It is independent of which files these are and of what happens if they are unreachable.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import socket
import ssl
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from urllib.parse import SplitResult, unquote, urlencode, urljoin, urlsplit

import attrs
import urllib3

from rigel_k8s.errors import LocalClusterError, UserError
from rigel_k8s.system.proxy import proxy_for
from rigel_k8s.system.tls import trust

REDIRECTIONS = 5

#: Lists of checksums and manifests of images are short; longer ones are cut off.
LONGEST = 1 << 20
CHUNK = 1 << 18
SHA256 = re.compile(r"[0-9a-fA-F]{64}")

#: Called with the bytes that have arrived, and their total (0 if the server does not report it).
Progress = Callable[[int, int], None]


class Unavailable(Exception):
    """A file cannot be downloaded; the text has the reason.

    Attributes:
        server: whether the whole server is unreachable, so that nothing else is requested from it.
    """

    def __init__(self, reason: str, *, server: bool = False) -> None:
        super().__init__(reason)
        self.server = server


@attrs.frozen
class Patience:
    """How many seconds a server may take.

    Attributes:
        connect: to resolve its name and to accept a connection.
        silence: without a single byte.
    """

    connect: float = 5
    silence: float = 10


@attrs.define
class Server:
    """Downloads files; certificates are checked, and proxies are those of the environment."""

    patience: Patience = attrs.field(factory=Patience)

    def read(self, url: str, accept: str = "*/*") -> bytes:
        """Return a short file.

        Args:
            accept: the media types that are supported.

        Raises:
            Unavailable: it cannot be read.
        """
        with self.open(url, accept) as answer:
            return bytes(answer.read(LONGEST))

    def read_sum(self, url: str, file: str) -> str:
        """Return the SHA-256 sum that a published list of sums has for a file, in hexadecimal.

        Raises:
            Unavailable: the list cannot be read, or does not name the file.
        """
        if found := find_sum(self.read(url).decode("utf-8", "replace"), file):
            return found
        raise Unavailable(f"{url} has no SHA-256 sum of {file}")

    def save(self, url: str, path: Path, expected: str, progress: Progress) -> None:
        """Download a file; it appears at `path` only after its sum was checked.

        Raises:
            Unavailable: it did not arrive, or not completely.
            LocalClusterError: it does not match its sum.
        """
        part = path.with_name(f"{path.name}.part")
        digest, done = hashlib.sha256(), 0
        try:
            with self.open(url) as answer, part.open("wb") as file:
                total = int(answer.headers.get("Content-Length") or 0)
                for chunk in answer.stream(CHUNK, decode_content=False):
                    file.write(chunk)
                    digest.update(chunk)
                    done += len(chunk)
                    progress(done, total)
            if digest.hexdigest() != expected:
                raise wrong_sum(url, expected, digest.hexdigest())
            part.rename(path)
        finally:
            part.unlink(missing_ok=True)

    @contextmanager
    def open(self, url: str, accept: str = "*/*") -> Iterator[urllib3.BaseHTTPResponse]:
        """Request a file and give its answer, whose body is still to be read.

        Raises:
            Unavailable: it does not exist, or the connection breaks while it is read.
        """
        try:
            with self.follow(url, {"Accept": accept}) as answer:
                yield answer
        except urllib3.exceptions.TimeoutError as error:
            silence = f"{urlsplit(url).netloc} sent nothing for {self.patience.silence:g} s"
            raise Unavailable(silence, server=True) from error
        except urllib3.exceptions.ProtocolError as error:
            raise Unavailable(f"the connection to {url} broke") from error
        except urllib3.exceptions.HTTPError as error:
            raise Unavailable(f"{url}: {error}") from error

    @contextmanager
    def follow(self, url: str, headers: Mapping[str, str]) -> Iterator[urllib3.BaseHTTPResponse]:
        """Give the answer to a GET, after redirections, which never leave TLS."""
        place, token = url, ""
        for _ in range(REDIRECTIONS):
            login = {"Authorization": f"Bearer {token}"} if token and place == url else {}
            with self.ask(place, {**headers, **login}) as answer:
                challenge = answer.headers.get("WWW-Authenticate") or ""
                if answer.status == 401 and challenge.startswith("Bearer ") and not token:
                    token = self.anonymous_token(challenge)
                    continue
                if location := answer.get_redirect_location():
                    before, place = place, urljoin(place, location)
                    if before.startswith("https:") and not place.startswith("https:"):
                        raise Unavailable(f"{url} redirects from TLS to {place}")
                    continue
                if answer.status != 200:
                    raise Unavailable(f"{url}: HTTP {answer.status}")
                yield answer
                return
        raise Unavailable(f"{url} redirects without end")

    def anonymous_token(self, challenge: str) -> str:
        """Return an image registry's token for anonymous users."""
        words = dict(re.findall(r'(\w+)="([^"]*)"', challenge))
        answer = self.read(f"{words.pop('realm', '')}?{urlencode(words)}")
        try:
            return str(json.loads(answer)["token"])
        except (ValueError, KeyError, TypeError) as error:
            raise Unavailable("the registry gives no token to anonymous users") from error

    @contextmanager
    def ask(self, url: str, headers: Mapping[str, str]) -> Iterator[urllib3.BaseHTTPResponse]:
        """Send one GET and give its answer."""
        try:
            proxy = proxy_for("", urlsplit(url), os.environ)
        except UserError as error:
            raise Unavailable(error.message) from error
        connect(proxy or urlsplit(url), self.patience.connect)
        with pool_manager(proxy) as http:
            answer = http.request(
                "GET",
                url,
                headers={"User-Agent": "rigel", "Accept-Encoding": "identity", **headers},
                preload_content=False,
                redirect=False,
                retries=False,
                timeout=urllib3.Timeout(connect=self.patience.connect, read=self.patience.silence),
            )
            try:
                yield answer
            finally:
                answer.close()


def connect(place: SplitResult, seconds: float) -> None:
    """Check whether a server accepts connections.

    Resolving a name has no time-out of its own, hence the thread.

    Raises:
        Unavailable: it does not within the time.
    """
    host, port = place.hostname or "", place.port or (443 if place.scheme == "https" else 80)
    result = [f"no connection within {seconds:g} s"]

    def attempt() -> None:
        try:
            socket.create_connection((host, port), seconds).close()
            result[0] = ""
        except OSError as error:
            result[0] = error.strerror or str(error)

    thread = threading.Thread(target=attempt, daemon=True)
    thread.start()
    thread.join(seconds)
    if reason := result[0]:
        raise Unavailable(f"cannot reach {host} ({reason})", server=True)


def pool_manager(proxy: SplitResult | None) -> urllib3.PoolManager:
    """Return the object that sends requests."""
    if proxy is None:
        return urllib3.PoolManager(ssl_context=certificate_authorities())
    login = f"{proxy.username}:{proxy.password or ''}" if proxy.username else None
    headers = urllib3.make_headers(proxy_basic_auth=unquote(login)) if login else None
    return urllib3.ProxyManager(
        proxy.geturl(), proxy_headers=headers, ssl_context=certificate_authorities()
    )


@cache
def certificate_authorities() -> ssl.SSLContext:
    """Return the authorities that this machine trusts, which take a while to read."""
    return trust()


def find_sum(text: str, file: str) -> str:
    """Return a file's sum from a list of them, "" if it is not in it.

    A list has lines of a sum and a file, which may stand behind a directory or a `*`; a list of
    one file may be its sum alone.
    """
    for line in text.splitlines():
        words = line.split()
        names = [word.lstrip("*").rsplit("/", 1)[-1] for word in words[1:]]
        if words and SHA256.fullmatch(words[0]) and names in ([], [file]):
            return words[0].lower()
    return ""


def wrong_sum(url: str, expected: str, received: str) -> LocalClusterError:
    """Return the error for a file that does not match its sum."""
    return LocalClusterError(
        f"{url} does not match its published checksum",
        details=[f"expected  sha256 {expected}", f"received  sha256 {received}"],
        hint="nothing was kept: try again later, or `rigel cluster up --from-source` compiles"
        " the programs",
    )

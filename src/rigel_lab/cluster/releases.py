"""Programs that their projects release, downloaded: each file matches its published checksum.

What is unreachable is compiled (`gobuild`).
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import ssl
import tarfile
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import attrs
import urllib3

from rigel_k8s.errors import LocalClusterError, UserError
from rigel_k8s.system.cache import cache_dir
from rigel_k8s.system.oci import architecture
from rigel_k8s.system.tls import environment_proxy, trust
from rigel_lab.cluster.commands import REPORT_EVERY, Report, StepProgress

#: The variable that names a mirror, and its value if nothing is to be downloaded.
MIRROR, NO_MIRROR = "RIGEL_CLUSTER_MIRROR", "none"
REDIRECTIONS = 5
#: Seconds to accept a connection.
PATIENCE = 5
#: Lists of checksums are short; longer ones are cut off.
LONGEST = 1 << 20
CHUNK = 1 << 18
SHA256 = re.compile(r"[0-9a-fA-F]{64}")


class Unavailable(Exception):
    """A file cannot be downloaded; the text has the reason.

    Attributes:
        server: whether the whole server is unreachable, so that nothing else is requested from it.
    """

    def __init__(self, reason: str, *, server: bool = False) -> None:
        super().__init__(reason)
        self.server = server


@attrs.frozen
class Release:
    """Where a project publishes programs; `{arch}` is this machine's architecture.

    Attributes:
        directory: the URL of the directory, without a slash at its end.
        archive: the tar file that has them all; "" if each is a separate file.
        sums: the list of SHA-256 sums; `{file}` is the file that is downloaded.
    """

    directory: str
    archive: str = ""
    sums: str = "{file}.sha256"

    def list_files(self, wanted: Mapping[str, str]) -> list[str]:
        """Return the files to download, for names there."""
        if self.archive:
            return [self.archive.format(arch=architecture())]
        return list(wanted.values())

    def url(self, file: str) -> str:
        return f"{self.directory.format(arch=architecture())}/{file}"

    def place(self, name: str, version: str, wanted: Mapping[str, str]) -> Path:
        """Return where the cache keeps its programs; never where compiled ones are."""
        words = [repr(self), *(f"{k}={v}" for k, v in wanted.items())]
        digest = hashlib.sha256(" ".join(words).encode()).hexdigest()[:12]
        return cache_dir() / "released" / f"{name}-{version}-{architecture()}-{digest}"


@attrs.define
class Upstream:
    """The servers of releases in one run, or a mirror that replaces all of them.

    Attributes:
        mirror: the URL below which HOST/PATH replaces https://HOST/PATH; "" for upstream's own
            servers, NO_MIRROR for none.
        silence: seconds that a server may send nothing.
        unreachable: server -> why nothing more is requested from it.
    """

    mirror: str = ""
    silence: float = 10
    unreachable: dict[str, Unavailable] = attrs.field(factory=dict, init=False)
    _authorities: ssl.SSLContext = attrs.field(factory=trust, init=False)

    @classmethod
    def of(cls, environ: Mapping[str, str] = os.environ) -> Upstream:
        """Return the servers to use, as the environment sets them.

        Raises:
            UserError: the mirror is not a URL.
        """
        text = environ.get(MIRROR, "").rstrip("/")
        if text not in ("", NO_MIRROR) and not re.match(r"https?://[^/]", text):
            raise UserError(
                f"the mirror {text!r} is not a URL",
                hint=f"set {MIRROR} to http://HOST:PORT/PATH, or to `{NO_MIRROR}` to compile"
                " everything",
            )
        return cls(text)

    @property
    def wanted(self) -> bool:
        """Whether released programs are used at all."""
        return self.mirror != NO_MIRROR

    def locate(self, url: str) -> str:
        """Return the URL from which a file of upstream's is downloaded."""
        return f"{self.mirror}/{url.removeprefix('https://')}" if self.mirror else url

    def fetch(
        self, release: Release, wanted: Mapping[str, str], place: Path, title: str, report: Report
    ) -> None:
        """Download programs into a directory, which appears when everything in it was checked.

        Args:
            wanted: our name of each file -> its name there.
            place: the directory.
            title: its name, for people.

        Raises:
            Unavailable: it cannot be downloaded now.
            LocalClusterError: the file differs from what was published.
        """
        host = urlsplit(self.locate(release.directory)).netloc
        if host in self.unreachable:
            raise self.unreachable[host]
        work = place.with_name(f".{place.name}")
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        progress = Progress(title, host, report)
        try:
            for file in release.list_files(wanted):
                sums = release.url(release.sums.format(file=file))
                expected = self.read_sum(self.locate(sums), file)
                self.save(self.locate(release.url(file)), work / file, expected, progress)
            if release.archive:
                unpack(work / file, wanted, work)
            for name in wanted:
                (work / name).chmod(0o755)
            work.rename(place)
        except Unavailable as error:
            if error.server:
                self.unreachable[host] = error
            raise
        finally:
            shutil.rmtree(work, ignore_errors=True)

    def read_sum(self, url: str, file: str) -> str:
        """Return the SHA-256 sum that a published list of sums has for a file, in hexadecimal.

        Raises:
            Unavailable: the list cannot be read, or does not name the file.
        """
        with self.open(url) as answer:
            text = answer.read(LONGEST).decode("utf-8", "replace")
        if found := find_sum(text, file):
            return found
        raise Unavailable(f"{url} has no SHA-256 sum of {file}")

    def save(self, url: str, path: Path, expected: str, progress: Progress) -> None:
        """Download a file.

        Raises:
            Unavailable: it did not arrive, or not completely.
            LocalClusterError: it does not match its sum.
        """
        digest, done = hashlib.sha256(), 0
        with self.open(url) as answer, path.open("wb") as file:
            total = int(answer.headers.get("Content-Length") or 0)
            for chunk in answer.stream(CHUNK, decode_content=False):
                file.write(chunk)
                digest.update(chunk)
                done += len(chunk)
                progress.count(path.name, done, total)
        if digest.hexdigest() != expected:
            raise LocalClusterError(
                f"{url} does not match its published checksum",
                details=[f"expected  sha256 {expected}", f"received  sha256 {digest.hexdigest()}"],
                hint=f"nothing was kept: try again later, or set {MIRROR}={NO_MIRROR}, which"
                " compiles the programs",
            )

    @contextmanager
    def open(self, url: str) -> Iterator[urllib3.BaseHTTPResponse]:
        """Request a file and give its answer, whose body is still to be read.

        Redirections never leave TLS: a sum that did not come over it proves nothing.

        Raises:
            Unavailable: it does not exist, or the connection breaks while it is read.
        """
        host = urlsplit(url).netloc
        try:
            request = self.connect(url).request(
                "GET",
                url,
                headers={"User-Agent": "rigel", "Accept-Encoding": "identity"},
                preload_content=False,
                retries=urllib3.Retry(REDIRECTIONS, connect=0, read=0),
                timeout=urllib3.Timeout(connect=PATIENCE, read=self.silence),
            )
            with closing(request) as answer:
                steps = answer.retries.history if answer.retries else ()
                plain = [step for step in steps if str(step.redirect_location).startswith("http:")]
                if plain and url.startswith("https:"):
                    raise Unavailable(f"{url} redirects from TLS to {plain[0].redirect_location}")
                if answer.status != 200:
                    raise Unavailable(f"{url}: HTTP {answer.status}")
                yield answer
        except urllib3.exceptions.HTTPError as error:
            cause = getattr(error, "reason", None) or error
            if isinstance(cause, urllib3.exceptions.ReadTimeoutError):
                reason = f"{host} sent nothing for {self.silence:g} s"
                raise Unavailable(reason, server=True) from error
            if isinstance(cause, urllib3.exceptions.ProtocolError):
                raise Unavailable(f"the connection to {url} broke") from error
            if isinstance(cause, urllib3.exceptions.ResponseError):
                raise Unavailable(f"{url} redirects without end") from error
            reason = getattr(cause.__cause__, "strerror", None) or str(cause)
            raise Unavailable(f"cannot reach {host} ({reason})", server=True) from error

    def connect(self, url: str) -> urllib3.PoolManager:
        """Return what sends requests: through the environment's proxy, if it has one."""
        proxy = environment_proxy(urlsplit(url), os.environ)
        if proxy:
            return urllib3.ProxyManager(proxy, ssl_context=self._authorities)
        return urllib3.PoolManager(ssl_context=self._authorities)


@attrs.define
class Progress:
    """Reports when the first bytes arrive, and from time to time how much of a file has."""

    title: str
    host: str
    report: Report
    begun: bool = False
    reported: float = attrs.field(factory=time.monotonic)

    def count(self, file: str, done: int, total: int) -> None:
        """Note how many bytes have arrived, and of how many (0: unknown)."""
        if not self.begun:
            self.begun = True
            self.report(f"Downloading {self.title} from {self.host}")
        if time.monotonic() - self.reported > REPORT_EVERY:
            self.reported = time.monotonic()
            of = f" of {total / 1e6:.0f}" if total else ""
            self.report(StepProgress(f"Downloading {self.title}: {file}, {done / 1e6:.0f}{of} MB"))


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


def unpack(archive: Path, wanted: Mapping[str, str], into: Path) -> None:
    """Replace an archive by the wanted files in it, whatever directory they are in there.

    Raises:
        Unavailable: it is not an archive, or does not have them all.
    """
    missing = {there: ours for ours, there in wanted.items()}
    try:
        with tarfile.open(archive) as tar:
            for member in tar:
                name = member.name.rsplit("/", 1)[-1]
                if member.isfile() and name in missing:
                    with (into / missing.pop(name)).open("wb") as file:
                        shutil.copyfileobj(tar.extractfile(member), file)  # type: ignore[arg-type]
    except (tarfile.TarError, EOFError, OSError) as error:
        raise Unavailable(f"{archive.name} cannot be unpacked: {error}") from error
    if missing:
        raise Unavailable(f"{archive.name} has no {', '.join(missing)}")
    archive.unlink()

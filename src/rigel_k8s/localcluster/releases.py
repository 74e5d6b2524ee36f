"""Programs that their projects release, as far as they are what a cluster needs.

It knows how a project lays out its releases and which server or mirror has them. What cannot be
reached is compiled, which is another matter (`gobuild`).
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tarfile
import time
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

import attrs

from rigel_k8s.cache import cache_dir
from rigel_k8s.errors import UserError
from rigel_k8s.localcluster.commands import Report
from rigel_k8s.localcluster.download import Server, Unavailable
from rigel_k8s.localcluster.oci import machine_architecture

__all__ = ["MIRROR", "NO_MIRROR", "Release", "Upstream"]

#: The variable that names a mirror.
MIRROR = "RIGEL_CLUSTER_MIRROR"
#: What it says where nothing is to be downloaded.
NO_MIRROR = "none"
#: Seconds between two reports of one download.
REPORT_EVERY = 15


@attrs.frozen
class Release:
    """Where a project publishes programs; `{arch}` is this machine's architecture.

    Attributes:
        directory: the URL of the directory, without a slash at its end.
        archive: the tar file that has them all; "" where each is a file of its own.
        sums: the list of SHA-256 sums; `{file}` is the file that is downloaded.
    """

    directory: str
    archive: str = ""
    sums: str = "{file}.sha256"

    def files(self, wanted: Mapping[str, str]) -> list[str]:
        """Return what is downloaded, for names there."""
        if self.archive:
            return [self.archive.format(arch=machine_architecture())]
        return list(wanted.values())

    def url(self, file: str) -> str:
        """Return the URL of a file."""
        return f"{self.directory.format(arch=machine_architecture())}/{file}"

    def place(self, name: str, version: str, wanted: Mapping[str, str]) -> Path:
        """Return where the cache keeps the programs; never where compiled ones are."""
        words = [self.directory, self.archive, *(f"{k}={v}" for k, v in wanted.items())]
        digest = hashlib.sha256(" ".join(words).encode()).hexdigest()[:12]
        return cache_dir() / "released" / f"{name}-{version}-{machine_architecture()}-{digest}"


@attrs.define
class Upstream:
    """The servers of releases in one run, or a mirror that stands for all of them.

    Attributes:
        mirror: the URL below which HOST/PATH is what https://HOST/PATH is; "" for upstream's own
            servers, NO_MIRROR for none.
        server: what downloads.
        unreachable: server -> why nothing more is asked of it.
    """

    mirror: str = ""
    server: Server = attrs.field(factory=Server)
    unreachable: dict[str, Unavailable] = attrs.field(factory=dict, init=False)

    @classmethod
    def of(cls, mirror: str | None, environ: Mapping[str, str] = os.environ) -> Upstream:
        """Return the servers that a user wants; None leaves it to the environment.

        Raises:
            UserError: the mirror is not a URL.
        """
        text = (environ.get(MIRROR, "") if mirror is None else mirror).rstrip("/")
        parts = urlsplit(text)
        if text not in ("", NO_MIRROR) and not (
            parts.scheme in ("http", "https") and parts.hostname
        ):
            raise UserError(
                f"the mirror {text!r} is not a URL",
                hint=f"--mirror or {MIRROR}: http://HOST:PORT/PATH, or `{NO_MIRROR}` to compile"
                " everything",
            )
        return cls(text)

    @property
    def wanted(self) -> bool:
        """Whether released programs are used at all."""
        return self.mirror != NO_MIRROR

    def locate(self, url: str) -> str:
        """Return where a file of upstream's is downloaded from."""
        return f"{self.mirror}/{url.removeprefix('https://')}" if self.mirror else url

    def fetch(
        self,
        release: Release,
        wanted: Mapping[str, str],
        place: Path,
        *,
        title: str,
        report: Report,
    ) -> None:
        """Download programs into a directory, which appears when everything in it was checked.

        Args:
            wanted: our name of each file -> its name there.
            place: the directory.
            title: what it is, for people.

        Raises:
            Unavailable: it cannot be downloaded now.
            LocalClusterError: something else came than was published.
        """
        host = urlsplit(self.locate(release.directory)).netloc
        if host in self.unreachable:
            raise self.unreachable[host]
        work = place.with_name(f".{place.name}")
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        try:
            for file in release.files(wanted):
                progress = Progress(f"Downloading {title}: {file}", report)
                self.download(release, file, work, progress)
            if release.archive:
                unpack(work / release.files(wanted)[0], wanted, work)
            for name in wanted:
                (work / name).chmod(0o755)
            work.rename(place)
        except Unavailable as error:
            if error.server:
                self.unreachable[host] = error
            raise
        finally:
            shutil.rmtree(work, ignore_errors=True)

    def download(self, release: Release, file: str, work: Path, progress: Progress) -> None:
        """Download one file and check it."""
        sums = self.locate(release.url(release.sums.format(file=file)))
        expected = self.server.read_sum(sums, file)
        self.server.save(self.locate(release.url(file)), work / file, expected, progress.count)


@attrs.define
class Progress:
    """Reports now and then how much of a file has arrived."""

    what: str
    report: Report
    reported: float = attrs.field(factory=time.monotonic)

    def count(self, done: int, total: int) -> None:
        """Take how many bytes have arrived, and of how many (0 is unknown)."""
        if time.monotonic() - self.reported > REPORT_EVERY:
            self.reported = time.monotonic()
            of = f" of {total / 1e6:.0f}" if total else ""
            self.report(f"{self.what}, {done / 1e6:.0f}{of} MB")


def unpack(archive: Path, wanted: Mapping[str, str], into: Path) -> None:
    """Replace an archive by the files in it that are wanted, whatever directory they are in there.

    Raises:
        Unavailable: it lacks one.
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
    archive.unlink()
    if missing:
        raise Unavailable(f"{archive.name} has no {', '.join(sorted(missing))}")

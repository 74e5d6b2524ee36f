"""Programs that their projects release and that a cluster needs.

This module defines how a project lays out its releases and which server or mirror has them. What is
unreachable is compiled (`gobuild`).
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tarfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TypeAlias
from urllib.parse import urlsplit

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.system.cache import cache_dir
from rigel_k8s.system.oci import architecture
from rigel_lab.cluster.commands import REPORT_EVERY, Report, StepProgress
from rigel_lab.cluster.download import Server, Unavailable

#: The variable that names a mirror.
MIRROR = "RIGEL_CLUSTER_MIRROR"
#: Its value if nothing is to be downloaded.
NO_MIRROR = "none"
#: The media types of an image's manifest, for one machine or for several.
MANIFESTS = ", ".join(
    (
        "application/vnd.oci.image.index.v1+json",
        "application/vnd.oci.image.manifest.v1+json",
        "application/vnd.docker.distribution.manifest.list.v2+json",
        "application/vnd.docker.distribution.manifest.v2+json",
    )
)


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

    @property
    def origin(self) -> str:
        """A URL on the server that has it."""
        return self.directory

    def files(self, wanted: Mapping[str, str]) -> list[str]:
        """Return the files to download, for names there."""
        if self.archive:
            return [self.archive.format(arch=architecture())]
        return list(wanted.values())

    def url(self, file: str) -> str:
        """Return the URL of a file."""
        return f"{self.directory.format(arch=architecture())}/{file}"

    def bring(
        self, wanted: Mapping[str, str], into: Path, upstream: Upstream, progress: Progress
    ) -> None:
        """Download and check the wanted files."""
        for file in self.files(wanted):
            sums = upstream.locate(self.url(self.sums.format(file=file)))
            expected = upstream.server.read_sum(sums, file)
            progress.file = file
            url = upstream.locate(self.url(file))
            upstream.server.save(url, into / file, expected, progress.count)
        if self.archive and (missing := unpack(into / file, wanted, into)):
            raise Unavailable(f"{file} has no {', '.join(missing)}")


@attrs.frozen
class ReleasedImage:
    """An image that a project publishes instead of programs; they are extracted from it.

    Its upper layers are searched first; the lower ones, which belong to a distribution, are left
    alone once everything is found. The tag is trusted as much as its registry's TLS certificate;
    from there on everything has its digest.
    """

    registry: str
    repository: str
    tag: str

    @property
    def origin(self) -> str:
        """A URL on the server that has it."""
        return f"https://{self.registry}/v2/{self.repository}"

    def bring(
        self, wanted: Mapping[str, str], into: Path, upstream: Upstream, progress: Progress
    ) -> None:
        """Download and check the wanted files."""
        missing = dict(wanted)
        for layer in reversed(self.layers(upstream)):
            algorithm, _, digest = str(layer["digest"]).partition(":")
            if algorithm != "sha256":
                raise Unavailable(f"{self.repository}:{self.tag} has a layer of {algorithm}")
            progress.file = f"layer {digest[:12]}"
            url = upstream.locate(f"{self.origin}/blobs/sha256:{digest}")
            upstream.server.save(url, into / digest, digest, progress.count)
            missing = unpack(into / digest, missing, into)
            if not missing:
                return
        raise Unavailable(f"{self.repository}:{self.tag} has no {', '.join(missing)}")

    def layers(self, upstream: Upstream) -> list[dict[str, str]]:
        """Return the layers for this machine, the lowest first."""
        try:
            index = json.loads(self.manifest(self.tag, upstream))
            own = {"os": "linux", "architecture": architecture()}
            for each in index.get("manifests", ()):
                if own.items() <= each["platform"].items():
                    text = self.manifest(each["digest"], upstream)
                    if f"sha256:{hashlib.sha256(text).hexdigest()}" != each["digest"]:
                        raise Unavailable(f"{self.repository}:{self.tag} does not match its digest")
                    index = json.loads(text)
                    break
            return list(index["layers"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise Unavailable(
                f"{self.repository}:{self.tag} is not an image for this machine"
            ) from error

    def manifest(self, name: str, upstream: Upstream) -> bytes:
        """Return a manifest by its tag or digest."""
        return upstream.server.read(upstream.locate(f"{self.origin}/manifests/{name}"), MANIFESTS)


#: Where programs are published.
Published: TypeAlias = Release | ReleasedImage


def place_of(release: Published, name: str, version: str, wanted: Mapping[str, str]) -> Path:
    """Return where the cache keeps released programs; never where compiled ones are."""
    words = [repr(release), *(f"{k}={v}" for k, v in wanted.items())]
    digest = hashlib.sha256(" ".join(words).encode()).hexdigest()[:12]
    return cache_dir() / "released" / f"{name}-{version}-{architecture()}-{digest}"


@attrs.define
class Upstream:
    """The servers of releases in one run, or a mirror that replaces all of them.

    Attributes:
        mirror: the URL below which HOST/PATH replaces https://HOST/PATH; "" for upstream's own
            servers, NO_MIRROR for none.
        server: the object that downloads.
        unreachable: server -> why nothing more is requested from it.
    """

    mirror: str = ""
    server: Server = attrs.field(factory=Server)
    unreachable: dict[str, Unavailable] = attrs.field(factory=dict, init=False)

    @classmethod
    def of(cls, mirror: str | None, environ: Mapping[str, str] = os.environ) -> Upstream:
        """Return the servers to use; None: as the environment sets them.

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
        """Return the URL from which a file of upstream's is downloaded."""
        return f"{self.mirror}/{url.removeprefix('https://')}" if self.mirror else url

    def host(self, release: Published) -> str:
        """Return the server of a release."""
        return urlsplit(self.locate(release.origin)).netloc

    def fetch(
        self,
        release: Published,
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
            title: its name, for people.

        Raises:
            Unavailable: it cannot be downloaded now.
            LocalClusterError: the file differs from what was published.
        """
        host = self.host(release)
        if host in self.unreachable:
            raise self.unreachable[host]
        work = place.with_name(f".{place.name}")
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
        try:
            release.bring(wanted, work, self, Progress(title, host, report))
            for name in wanted:
                (work / name).chmod(0o755)
            work.rename(place)
        except Unavailable as error:
            if error.server:
                self.unreachable[host] = error
            raise
        finally:
            shutil.rmtree(work, ignore_errors=True)


@attrs.define
class Progress:
    """Reports when the first bytes arrive, and from time to time how much of a file has."""

    title: str
    host: str
    report: Report
    file: str = ""
    begun: bool = False
    reported: float = attrs.field(factory=time.monotonic)

    def count(self, done: int, total: int) -> None:
        """Note how many bytes have arrived, and of how many (0: unknown)."""
        if not self.begun:
            self.begun = True
            self.report(f"Downloading {self.title} from {self.host}")
        if time.monotonic() - self.reported > REPORT_EVERY:
            self.reported = time.monotonic()
            of = f" of {total / 1e6:.0f}" if total else ""
            text = f"Downloading {self.title}: {self.file}, {done / 1e6:.0f}{of} MB"
            self.report(StepProgress(text))


def unpack(archive: Path, wanted: Mapping[str, str], into: Path) -> dict[str, str]:
    """Replace an archive by the wanted files in it, whatever directory they are in there.

    Returns:
        The wanted files that are not in it.

    Raises:
        Unavailable: it is not an archive.
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
    return {ours: there for there, ours in missing.items()}

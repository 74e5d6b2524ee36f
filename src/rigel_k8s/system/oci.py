"""Container images as the Open Container Initiative defines them, made without a container engine.

The same input gives the same bytes, so an unchanged image keeps its digest. This module is
independent of registries and ROS.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import tarfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import IO, Any

import attrs

#: It changes if the same layers give another archive.
FORMAT = "2"

_OCI = "application/vnd.oci.image"
#: The media type of a layer that is a plain tar.
UNCOMPRESSED = f"{_OCI}.layer.v1.tar"

_CHUNK = 1 << 20
_PLATFORMS = {
    "x86_64": "amd64",
    "amd64": "amd64",
    "aarch64": "arm64",
    "arm64": "arm64",
    "armv7l": "arm/v7",
    "armv6l": "arm/v6",
    "i386": "386",
    "i686": "386",
}


def host_platform() -> str:
    """Return this machine's platform as images have it; containers are Linux ones everywhere."""
    name = platform.machine().lower()
    return f"linux/{_PLATFORMS.get(name, name)}"


def architecture() -> str:
    """Return this machine's architecture as images have it: that of its platform."""
    return host_platform().split("/")[1]


@attrs.frozen
class Entry:
    """One file, symbolic link or directory of a layer.

    Attributes:
        path: inside the image, without a leading slash.
        content: of a file.
        link: the target of a link; empty: it is not a link.
        directory: whether it is a directory.
        mode: its permissions; None: what its kind usually has.
        owner: the number of the user and group that own it.
    """

    path: str
    content: bytes = b""
    link: str = ""
    directory: bool = False
    mode: int | None = None
    owner: int = 0


def layer(entries: Iterable[Entry], *, mtime: int) -> bytes:
    """Return a layer as an uncompressed tar, the entries in their order."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for entry in entries:
            tar.addfile(_member(entry, mtime), io.BytesIO(entry.content))
    return out.getvalue()


def _member(entry: Entry, mtime: int) -> tarfile.TarInfo:
    info = tarfile.TarInfo(entry.path)
    info.mtime, info.size = mtime, len(entry.content)
    info.uid = info.gid = entry.owner
    usual = 0o644
    if entry.link:
        info.type, info.linkname, usual = tarfile.SYMTYPE, entry.link, 0o777
    elif entry.directory:
        info.type, usual = tarfile.DIRTYPE, 0o755
    info.mode = usual if entry.mode is None else entry.mode
    return info


@attrs.frozen
class Blob:
    """A part of an image: its kind, its address by content, its size in bytes, and the content."""

    media_type: str
    digest: str
    size: int
    open: Callable[[], IO[bytes]]

    @property
    def descriptor(self) -> dict[str, Any]:
        """How another part refers to it."""
        return {"mediaType": self.media_type, "digest": self.digest, "size": self.size}

    @property
    def path(self) -> str:
        return f"blobs/{self.digest.replace(':', '/')}"

    def read(self) -> bytes:
        with self.open() as file:
            return file.read()


@attrs.frozen
class Image:
    """The parts of an image, ready for an archive or a registry; the lowest layer comes first."""

    manifest: Blob
    config: Blob
    layers: tuple[Blob, ...]


def digest(content: bytes) -> str:
    """Return the address of some content."""
    return f"sha256:{hashlib.sha256(content).hexdigest()}"


def blob(media_type: str, content: bytes) -> Blob:
    """Return a part of an image from its content."""
    return Blob(media_type, digest(content), len(content), lambda: io.BytesIO(content))


def blob_of(media_type: str, path: Path) -> Blob:
    """Return a part of an image from a file, which is not held in memory."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            found.update(chunk)
    address = f"sha256:{found.hexdigest()}"
    return Blob(media_type, address, path.stat().st_size, lambda: path.open("rb"))


def encode_json(value: object) -> bytes:
    """Return JSON that depends on nothing but the value."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def assemble(
    config: Mapping[str, Any],
    layers: Sequence[Blob],
    *,
    created: int | None = None,
    arch: str | None = None,
) -> Image:
    """Return the image of these layers.

    Args:
        config: the `config` of an OCI image configuration: Entrypoint, Cmd, Env.
        layers: uncompressed, the lowest first.
        created: seconds since 1970; None: the image does not record when it was made, nor how.
        arch: the architecture of its programs; None: that of this machine.
    """
    moment = None
    if created is not None:
        moment = datetime.fromtimestamp(created, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    image: dict[str, Any] = {
        "architecture": arch or architecture(),
        "os": "linux",
        "config": dict(config),
        "rootfs": {"type": "layers", "diff_ids": [one.digest for one in layers]},
    }
    if moment:
        # buildah refuses to build on an image whose history does not count its layers.
        history = [{"created": moment, "created_by": "rigel-k8s"} for _ in layers]
        image |= {"created": moment, "history": history}
    configuration = blob(f"{_OCI}.config.v1+json", encode_json(image))
    manifest = {
        "schemaVersion": 2,
        "mediaType": f"{_OCI}.manifest.v1+json",
        "config": configuration.descriptor,
        "layers": [one.descriptor for one in layers],
    }
    return Image(
        blob(f"{_OCI}.manifest.v1+json", encode_json(manifest)), configuration, tuple(layers)
    )


def write_archive(
    target: Path,
    layers: Sequence[Path],
    config: Mapping[str, Any],
    reference: str,
    *,
    created: int,
    arch: str | None = None,
) -> str:
    """Write an image of uncompressed layer tars and return its id (the configuration's digest).

    The file is an OCI image layout and a docker archive at once: both indexes name the same parts,
    so podman, docker and containerd, old and new, load it without conversion.

    Args:
        target: the archive to write; it appears only when it is complete.
        layers: layer tars, the lowest first.
        config: as in `assemble`.
        reference: the name that engines give the image when they load it.
        created: seconds since 1970.
        arch: as in `assemble`.
    """
    parts = [blob_of(UNCOMPRESSED, path) for path in layers]
    image = assemble(config, parts, created=created, arch=arch)
    partial = target.with_suffix(".partial")
    with tarfile.open(partial, "w", format=tarfile.PAX_FORMAT) as tar:
        for part in (*image.layers, image.config, image.manifest):
            with part.open() as file:
                tar.addfile(_file(part.path, part.size, created), file)
        for name, content in _indexes(image, reference):
            tar.addfile(_file(name, len(content), created), io.BytesIO(content))
    partial.replace(target)
    return image.config.digest


def read_archive(tar: tarfile.TarFile) -> Image:
    """Return the one image of an open archive that is an OCI image layout."""

    def part(descriptor: Mapping[str, Any]) -> Blob:
        address, size = descriptor["digest"], descriptor["size"]
        found = Blob(descriptor["mediaType"], address, size, lambda: member(found.path))
        return found

    def member(name: str) -> IO[bytes]:
        file = tar.extractfile(name)
        assert file is not None, f"{name} is not a file"
        return file

    with member("index.json") as file:
        manifest = part(json.load(file)["manifests"][0])
    described = json.loads(manifest.read())
    return Image(manifest, part(described["config"]), tuple(map(part, described["layers"])))


def _indexes(image: Image, reference: str) -> list[tuple[str, bytes]]:
    """Return the files of an archive that list its parts, for OCI's readers and docker's."""
    named = {
        **image.manifest.descriptor,
        "annotations": {
            "io.containerd.image.name": reference,
            "org.opencontainers.image.ref.name": reference.rpartition(":")[2],
        },
    }
    docker = {
        "Config": image.config.path,
        "RepoTags": [reference],
        "Layers": [one.path for one in image.layers],
    }
    return [
        ("oci-layout", encode_json({"imageLayoutVersion": "1.0.0"})),
        ("index.json", encode_json({"schemaVersion": 2, "manifests": [named]})),
        ("manifest.json", encode_json([docker])),
    ]


def _file(name: str, size: int, created: int) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size, info.mtime, info.mode = size, created, 0o644
    return info

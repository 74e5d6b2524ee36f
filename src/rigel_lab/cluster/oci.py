"""Container images without a container engine: one layer of given files, pushed over HTTP.

The bytes depend on nothing but the files, so the same programs give the same digest.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import tarfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO
from urllib.parse import urljoin

import attrs
import urllib3

from rigel_k8s.errors import LocalClusterError

__all__ = ["Image", "push", "put_blob", "refuse"]

#: As nearly every image has it; CNI programs look for iptables along it on the node.
PATH = "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


@attrs.frozen
class Image:
    """An image to be: files by their path inside, links by their path, and what it starts.

    Attributes:
        files: path inside (no leading slash) -> a program on this machine, or text.
        links: path inside -> target.
        command: what it starts, or the arguments of the entrypoint, where nothing else is said.
        user: as whom, by name or number; root where nothing is said.
        owned: directory inside -> the number of the user and group to whom it belongs.
        volume: the one of these that is a volume of its own, and where it starts.
    """

    name: str
    files: Mapping[str, Path | str]
    entrypoint: Sequence[str]
    links: Mapping[str, str] = attrs.field(factory=dict)
    command: Sequence[str] = ()
    user: str = ""
    owned: Mapping[str, int] = attrs.field(factory=dict)
    volume: str = ""

    @property
    def config(self) -> dict[str, object]:
        """What the image says of its start; what it does not say is left out."""
        said = {
            "Entrypoint": list(self.entrypoint),
            "Cmd": list(self.command),
            "User": self.user,
            "WorkingDir": self.volume,
            "Volumes": {self.volume: {}} if self.volume else {},
        }
        return {**{key: words for key, words in said.items() if words}, "Env": [PATH]}

    def layer(self) -> bytes:
        """Return the uncompressed tar of the one layer."""
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w", format=tarfile.PAX_FORMAT) as tar:
            for directory in sorted({"tmp", *self.owned, *self._parents()}):
                entry = tarfile.TarInfo(directory)
                entry.type, entry.mode = tarfile.DIRTYPE, 0o1777 if directory == "tmp" else 0o755
                entry.uid = entry.gid = self.owned.get(directory, 0)
                tar.addfile(entry)
            for path, content in sorted(self.files.items()):
                data = content.encode() if isinstance(content, str) else content.read_bytes()
                entry = tarfile.TarInfo(path)
                entry.size, entry.mode = len(data), 0o644 if isinstance(content, str) else 0o755
                tar.addfile(entry, io.BytesIO(data))
            for path, target in sorted(self.links.items()):
                entry = tarfile.TarInfo(path)
                entry.type, entry.linkname = tarfile.SYMTYPE, target
                tar.addfile(entry)
        return buffer.getvalue()

    def _parents(self) -> set[str]:
        paths = [Path(p) for p in [*self.files, *self.links, *self.owned]]
        return {str(parent) for p in paths for parent in p.parents if str(parent) != "."}


def push(image: Image, registry: str) -> None:
    """Push an image to `registry` (HOST:PORT, plain HTTP) as `registry/image.name`.

    Raises:
        LocalClusterError: the registry refused a part.
    """
    repository, tag = image.name.rsplit(":", 1)
    layer = image.layer()
    blob = gzip.compress(layer, compresslevel=1, mtime=0)
    config = json.dumps(
        {
            "architecture": machine_architecture(),
            "os": "linux",
            "config": image.config,
            "rootfs": {"type": "layers", "diff_ids": [digest(layer)]},
        }
    ).encode()
    manifest = json.dumps(
        {
            "schemaVersion": 2,
            "mediaType": "application/vnd.oci.image.manifest.v1+json",
            "config": descriptor("application/vnd.oci.image.config.v1+json", config),
            "layers": [descriptor("application/vnd.oci.image.layer.v1.tar+gzip", blob)],
        }
    ).encode()
    http = urllib3.PoolManager(retries=False)
    base = f"http://{registry}/v2/{repository}"
    for part in (blob, config):
        put_blob(http, base, digest(part), part, len(part))
    answer = http.request(
        "PUT",
        f"{base}/manifests/{tag}",
        body=manifest,
        headers={"Content-Type": "application/vnd.oci.image.manifest.v1+json"},
    )
    refuse(answer, image.name)


def put_blob(
    http: urllib3.PoolManager, base: str, name: str, data: bytes | IO[bytes], size: int
) -> None:
    """Upload one blob of a digest and a size in bytes where the registry lacks it.

    Raises:
        LocalClusterError: the registry refused it.
    """
    if http.request("HEAD", f"{base}/blobs/{name}").status == 200:
        return
    start = http.request("POST", f"{base}/blobs/uploads/")
    refuse(start, base)
    place = urljoin(base, start.headers["Location"])
    place += ("&" if "?" in place else "?") + f"digest={name}"
    kind = {"Content-Type": "application/octet-stream", "Content-Length": str(size)}
    refuse(http.request("PUT", place, body=data, headers=kind), base)


def refuse(answer: urllib3.BaseHTTPResponse, what: str) -> None:
    """Raise where the registry did not accept."""
    if answer.status >= 300:
        raise LocalClusterError(f"the local registry refused {what}: HTTP {answer.status}")


def digest(data: bytes) -> str:
    """Return the content address of some bytes."""
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


def descriptor(media_type: str, data: bytes) -> dict[str, object]:
    """Return an OCI descriptor."""
    return {"mediaType": media_type, "digest": digest(data), "size": len(data)}


def machine_architecture() -> str:
    """Return this machine's architecture as images name it."""
    import platform

    names = {"x86_64": "amd64", "aarch64": "arm64", "armv7l": "arm"}
    return names.get(platform.machine(), platform.machine())

"""Images for a cluster's own registry: one layer of given files, or an archive that others made."""

from __future__ import annotations

import tarfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from urllib.parse import urljoin

import attrs
import urllib3

from rigel_k8s.errors import LocalClusterError
from rigel_k8s.system import oci

#: As nearly every image has it; CNI programs look for iptables along it on the node.
PATH = "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


@attrs.frozen
class Image:
    """A new image: files by their path inside, links by their path, and what it starts.

    Attributes:
        files: path inside (no leading slash) -> a program on this machine, or text.
        links: path inside -> target.
        command: what it starts, or the arguments of the entrypoint, by default.
        user: the user, by name or number; root by default.
        owned: directory inside -> the number of the user and group that own it.
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
        """The image's configuration of its start; what is not set is left out."""
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
        return oci.layer(self._entries(), mtime=0)

    def parts(self) -> oci.Image:
        # Uncompressed: between this machine and its own nodes, gzip takes longer than it saves.
        return oci.assemble(self.config, [oci.blob(oci.UNCOMPRESSED, self.layer())])

    def _entries(self) -> Iterator[oci.Entry]:
        for directory in sorted({"tmp", *self.owned, *self._parents()}):
            mode = 0o1777 if directory == "tmp" else 0o755
            owner = self.owned.get(directory, 0)
            yield oci.Entry(directory, directory=True, mode=mode, owner=owner)
        for path, content in sorted(self.files.items()):
            if isinstance(content, str):
                yield oci.Entry(path, content.encode())
            else:
                yield oci.Entry(path, content.read_bytes(), mode=0o755)
        for path, target in sorted(self.links.items()):
            yield oci.Entry(path, link=target, mode=0o644)

    def _parents(self) -> set[str]:
        paths = [Path(p) for p in [*self.files, *self.links, *self.owned]]
        return {str(parent) for p in paths for parent in p.parents if str(parent) != "."}


def push(image: Image, registry: str) -> None:
    """Push an image to `registry` (HOST:PORT, plain HTTP) as `registry/image.name`.

    Raises:
        LocalClusterError: the registry refused a part.
    """
    _Repository.of(image.name, registry).put(image.parts())


def push_archive(path: Path, name: str, registry: str) -> bool:
    """Push the image of an archive, as it is, to `registry` (HOST:PORT, plain HTTP) as `name`.

    Returns:
        Whether anything was pushed: not if that very image already has the name there.

    Raises:
        LocalClusterError: the registry refused a part.
    """
    repository = _Repository.of(name, registry)
    with tarfile.open(path) as tar:
        image = oci.read_archive(tar)
        if repository.has(image):
            return False
        repository.put(image)
    return True


@attrs.frozen
class _Repository:
    """Where a registry has the images of one name, and the name of one of them."""

    http: urllib3.PoolManager
    base: str
    name: str

    @classmethod
    def of(cls, name: str, registry: str) -> _Repository:
        path = name.rpartition(":")[0]
        return cls(urllib3.PoolManager(retries=False), f"http://{registry}/v2/{path}", name)

    @property
    def manifest(self) -> str:
        return f"{self.base}/manifests/{self.name.rpartition(':')[2]}"

    def has(self, image: oci.Image) -> bool:
        kind = {"Accept": image.manifest.media_type}
        there = self.http.request("HEAD", self.manifest, headers=kind)
        return there.headers.get("Docker-Content-Digest") == image.manifest.digest

    def put(self, image: oci.Image) -> None:
        for part in (image.config, *image.layers):
            self.put_blob(part)
        kind = {"Content-Type": image.manifest.media_type}
        text = image.manifest.read()
        answer = self.http.request("PUT", self.manifest, body=text, headers=kind)
        _refuse(answer, self.name)

    def put_blob(self, blob: oci.Blob) -> None:
        """Upload a part if the registry does not have it, without holding all of it in memory."""
        if self.http.request("HEAD", f"{self.base}/blobs/{blob.digest}").status == 200:
            return
        start = self.http.request("POST", f"{self.base}/blobs/uploads/")
        _refuse(start, self.base)
        place = urljoin(self.base, start.headers["Location"])
        place += ("&" if "?" in place else "?") + f"digest={blob.digest}"
        kind = {"Content-Type": "application/octet-stream", "Content-Length": str(blob.size)}
        with blob.open() as content:
            answer = self.http.request("PUT", place, body=content, headers=kind)
        _refuse(answer, self.base)


def _refuse(answer: urllib3.BaseHTTPResponse, what: str) -> None:
    """Raise if the registry did not accept it."""
    if answer.status >= 300:
        raise LocalClusterError(f"the local registry refused {what}: HTTP {answer.status}")

"""The local cluster's own images, and what a registry gets of them."""

from __future__ import annotations

import hashlib
import io
import os
import tarfile
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import attrs
import pytest

from rigel_k8s.errors import LocalClusterError
from rigel_k8s.system.oci import layer, write_archive
from rigel_lab.cluster.oci import Image, push, push_archive


def image(program: Path) -> Image:
    return Image("a/b:1", {"bin/x": program, "etc/y": "text"}, ["/bin/x"], links={"bin/sh": "x"})


def test_the_same_files_give_the_same_bytes(tmp_path: Path) -> None:
    """Neither the time nor a file's date or owner changes an image's digest."""
    program = tmp_path / "x"
    program.write_bytes(b"\x7fELF")
    first = image(program).layer()
    os.utime(program, (1, 1))
    program.chmod(0o700)
    assert image(program).layer() == first


def test_a_layer_holds_directories_files_and_links(tmp_path: Path) -> None:
    """Every parent is there before its files, programs are executable, /tmp is everybody's."""
    program = tmp_path / "x"
    program.write_bytes(b"\x7fELF")
    with tarfile.open(fileobj=io.BytesIO(image(program).layer())) as tar:
        members = {member.name: member for member in tar}
    assert list(members) == ["bin", "etc", "tmp", "bin/x", "etc/y", "bin/sh"]
    assert members["bin/x"].mode == 0o755
    assert members["etc/y"].mode == 0o644
    assert members["tmp"].mode == 0o1777
    assert members["bin/sh"].linkname == "x"


class Registry(ThreadingHTTPServer):
    """A registry that keeps what it is given in memory, or refuses one thing."""

    def __init__(self) -> None:
        self.blobs: dict[str, bytes] = {}
        self.manifests: dict[str, tuple[str, bytes]] = {}
        self.uploads = 0
        self.refuses = ""
        super().__init__(("127.0.0.1", 0), Handler)

    @property
    def name(self) -> str:
        return f"127.0.0.1:{self.server_address[1]}"


class Handler(BaseHTTPRequestHandler):
    """The part of the distribution protocol that a push needs."""

    server: Registry

    def answer(self, status: int, **headers: str) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def do_HEAD(self) -> None:
        _, _, found = self.path.rpartition("/")
        if "/blobs/" in self.path:
            self.answer(200 if found in self.server.blobs else 404)
        elif self.path in self.server.manifests:
            text = self.server.manifests[self.path][1]
            digest = f"sha256:{hashlib.sha256(text).hexdigest()}"
            self.answer(200, Docker_Content_Digest=digest)
        else:
            self.answer(404)

    def do_POST(self) -> None:
        self.answer(202, Location="/up?state=1")

    def do_PUT(self) -> None:
        content = self.rfile.read(int(self.headers["Content-Length"]))
        if self.server.refuses and self.server.refuses in self.path:
            self.answer(403)
        elif self.path.startswith("/up?state=1&digest="):
            self.server.blobs[self.path.partition("digest=")[2]] = content
            self.server.uploads += 1
            self.answer(201)
        else:
            self.server.manifests[self.path] = (self.headers["Content-Type"], content)
            self.answer(201)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def registry() -> Iterator[Registry]:
    with Registry() as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_a_pushed_image_has_the_same_digests_in_each_release(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Layer, configuration and manifest are the same bytes from release to release."""
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    program = tmp_path / "x"
    program.write_bytes(b"\x7fELF")
    own = attrs.evolve(
        image(program), command=["-v"], user="nobody", owned={"data": 65534}, volume="/data"
    )
    push(own, registry.name)
    assert set(registry.blobs) == {
        "sha256:eff53fabad4546a46e049ccb4128a698cb29cfcbc00f6a09e4833daa72fda5fe",
        "sha256:bc9f99512aacda460485f1d51edd2b7fd8365f2e8e4710f825cfb42d145680d0",
    }
    for name, content in registry.blobs.items():
        assert name == f"sha256:{hashlib.sha256(content).hexdigest()}"
    ((path, (kind, manifest)),) = registry.manifests.items()
    assert (path, kind) == ("/v2/a/b/manifests/1", "application/vnd.oci.image.manifest.v1+json")
    assert hashlib.sha256(manifest).hexdigest() == (
        "bee8049d57a5ddb6433a0521425087d0f865ce75d03926b6d1cfe50dbccb0db4"
    )


def test_what_a_registry_has_is_not_uploaded_again(registry: Registry, tmp_path: Path) -> None:
    """Images that share a layer upload it once."""
    program = tmp_path / "x"
    program.write_bytes(b"\x7fELF")
    push(image(program), registry.name)
    assert registry.uploads == 2
    push(attrs.evolve(image(program), name="a/b:2"), registry.name)
    assert registry.uploads == 2
    assert len(registry.manifests) == 2


def test_an_archive_is_pushed_as_it_is_and_once(registry: Registry, tmp_path: Path) -> None:
    """The same image twice is one upload; another one takes its name over."""
    (tmp_path / "layer").write_bytes(layer([], mtime=0))
    files = [tmp_path / "one.tar", tmp_path / "two.tar"]
    for file in files:
        config = {"Cmd": [file.name]}
        write_archive(file, [tmp_path / "layer"], config, "localhost/x:1", created=0)
    pushed = [push_archive(files[n], "a/b:1", registry.name) for n in (0, 0, 1, 1, 0)]
    assert pushed == [True, False, True, False, True]
    assert registry.uploads == 3  # one layer, two configurations
    with tarfile.open(files[0]) as tar:
        content = [tar.extractfile(member).read() for member in tar]  # type: ignore[union-attr]
    assert registry.manifests["/v2/a/b/manifests/1"][1] in content
    assert {*registry.blobs.values()} & {*content} == {*content[:2]}


@pytest.mark.parametrize("part", ["/up", "/manifests/"])
def test_a_registry_that_refuses_is_an_error(part: str, registry: Registry, tmp_path: Path) -> None:
    """No image is taken for pushed that is not."""
    program = tmp_path / "x"
    program.write_bytes(b"\x7fELF")
    registry.refuses = part
    with pytest.raises(LocalClusterError, match=r"the local registry refused .*: HTTP 403"):
        push(image(program), registry.name)

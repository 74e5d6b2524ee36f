"""A server that has released programs where their projects publish them, and their faults.

Below its root, HOST/PATH is what upstream has at https://HOST/PATH: a mirror, as
RIGEL_CLUSTER_MIRROR names one.

usage: python -m tests.support.release_server [--port 8099] [DIRECTORY]
       serves the programs that this machine has compiled, laid out in DIRECTORY
"""

from __future__ import annotations

import argparse
import hashlib
import io
import tarfile
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Literal

import attrs

from rigel_k8s.system.cache import cache_dir
from rigel_lab.cluster.components import GO_BUILDS, ON_REQUEST
from rigel_lab.cluster.gobuild import GoBuild
from rigel_lab.cluster.releases import Release

#: What can be wrong with a file: no answer at all, half of it and then nothing, half of it and the
#: connection's end; it is elsewhere.
Fault = Literal["silent", "stalls", "truncated", "moved"]


@attrs.define
class Releases:
    """A directory that is served, and what was asked for."""

    root: Path
    url: str = ""
    faults: dict[str, Fault] = attrs.field(factory=dict)
    asked: list[str] = attrs.field(factory=list)
    over: threading.Event = attrs.field(factory=threading.Event)

    def path(self, url: str) -> Path:
        """Where the file of an upstream URL is."""
        return self.root / url.removeprefix("https://")

    def publish(self, release: Release, content: Mapping[str, bytes]) -> None:
        """Publish files or an archive, each with its sum."""
        files = release.list_files({name: name for name in content})
        sums: dict[Path, str] = {}
        for file in files:
            path = self.path(release.url(file))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(archive(file, content) if release.archive else content[file])
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            own = self.path(release.url(release.sums.format(file=file)))
            # Kubernetes publishes a sum alone, the others a list of sums and names.
            sums[own] = f"{digest}  {file}\n" if release.archive else digest
        for path, text in sums.items():
            path.write_text(text)

    @contextmanager
    def serve(self, port: int = 0) -> Iterator[Releases]:
        """Serve them on loopback while the context is open."""
        with ThreadingHTTPServer(("127.0.0.1", port), partial(Handler, self)) as server:
            server.daemon_threads = True
            thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
            thread.start()
            self.url = f"http://127.0.0.1:{server.server_port}"
            try:
                yield self
            finally:
                self.over.set()
                server.shutdown()
                thread.join()


class Handler(SimpleHTTPRequestHandler):
    """Sends files, or what their faults say."""

    def __init__(self, releases: Releases, *args: Any) -> None:
        self.releases = releases
        super().__init__(*args, directory=str(releases.root))

    def do_GET(self) -> None:
        self.releases.asked.append(self.path)
        fault = self.releases.faults.get(self.path.lstrip("/"))
        if fault is None:
            super().do_GET()
            return
        if fault == "moved":
            self.send_response(302)
            self.send_header("Location", f"{self.path.partition('?')[0]}?moved")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        if fault != "silent":
            content = (self.releases.root / self.path.lstrip("/")).read_bytes()
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: len(content) // 2])
        if fault != "truncated":
            self.releases.over.wait(60)
        self.close_connection = True

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing."""


def archive(name: str, content: Mapping[str, bytes]) -> bytes:
    """A compressed tar file; Prometheus' family has a directory in it, the others have none."""
    top = f"{name.removesuffix('.tar.gz')}/" if name.endswith(".tar.gz") else "./"
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz", compresslevel=1) as tar:
        for file, data in content.items():
            entry = tarfile.TarInfo(f"{top}{file}")
            entry.size, entry.mode = len(data), 0o644
            tar.addfile(entry, io.BytesIO(data))
    return buffer.getvalue()


def find_compiled() -> Iterator[tuple[GoBuild, Path]]:
    """Yield what can be released and was compiled on this machine, and where."""
    for build in [*GO_BUILDS, *(build for some in ON_REQUEST.values() for build in some)]:
        places = (cache_dir() / "go").glob(f"{build.name}-{build.version}-*")
        there = [p for p in places if all((p / name).exists() for name in build.in_release)]
        if build.release and there:
            yield build, there[0]


def main() -> None:
    """Lay out what was compiled, and serve it until interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=8099)
    parser.add_argument("directory", type=Path, nargs="?")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        releases = Releases(words.directory or Path(temporary))
        for build, place in find_compiled():
            assert build.release
            content = {
                there: (place / ours).read_bytes() for ours, there in build.in_release.items()
            }
            releases.publish(build.release, content)
            print(f"{build.title}: {', '.join(build.in_release)}", flush=True)  # noqa: T201
        with releases.serve(words.port):
            print(f"export RIGEL_CLUSTER_MIRROR={releases.url}", flush=True)  # noqa: T201
            threading.Event().wait()


if __name__ == "__main__":
    main()

"""What comes from npm: from the registry that npm would ask, and only what was pinned."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path

import attrs
import pytest

from tests.support.http_server import Exchange, HttpServer, serving
from tools.npm import DAGRE, File, NotFetched, Package, find_registry, install

ROOT = Path(__file__).parents[3]
CONTENT = b"export const answer = 42;\n"


def pack(content: bytes = CONTENT) -> bytes:
    """Return an archive as npm has them."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        entry = tarfile.TarInfo("package/dist/library.js")
        entry.size = len(content)
        archive.addfile(entry, io.BytesIO(content))
    return packed.getvalue()


ARCHIVE = pack()
LIBRARY = Package(
    "@scope/library",
    "1.2.3",
    "sha512-" + base64.b64encode(hashlib.sha512(ARCHIVE).digest()).decode(),
    "MIT",
    (File("dist/library.js", "library.js", hashlib.sha256(CONTENT).hexdigest()),),
)


@attrs.define
class Registry:
    """An npm registry that has one archive."""

    server: HttpServer
    archive: bytes = ARCHIVE

    def answer(self, exchange: Exchange) -> None:
        exchange.say(200, self.archive)

    @property
    def asked(self) -> list[str]:
        return [request.path for request in self.server.requests]


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[Registry]:
    with serving(lambda exchange: exchange.say(404)) as server:
        made = Registry(server)
        server.answer = made.answer
        monkeypatch.setenv("npm_config_registry", f"{server.url}/npm/")
        for name in list(os.environ):
            if name.lower() == "http_proxy":
                monkeypatch.delenv(name)
        yield made


def test_files_are_fetched_once(registry: Registry, tmp_path: Path) -> None:
    """And again where one was changed or deleted."""
    for _ in range(2):
        install(LIBRARY, tmp_path / "lib")
    assert (tmp_path / "lib" / "library.js").read_bytes() == CONTENT
    assert registry.asked == ["/npm/@scope/library/-/library-1.2.3.tgz"]
    (tmp_path / "lib" / "library.js").write_text("something else")
    install(LIBRARY, tmp_path / "lib")
    assert (tmp_path / "lib" / "library.js").read_bytes() == CONTENT
    assert [path.name for path in (tmp_path / "lib").iterdir()] == ["library.js"]


def test_another_archive_is_refused(registry: Registry, tmp_path: Path) -> None:
    """Whoever has put it there: nothing of it is written."""
    registry.archive = pack(b"alert(1)")
    with pytest.raises(NotFetched, match=r"is not @scope/library 1\.2\.3 as it was pinned"):
        install(LIBRARY, tmp_path / "lib")
    assert not (tmp_path / "lib").exists()


@pytest.mark.parametrize(
    ("variables", "here", "home", "expected"),
    [
        ({}, "", "", "https://registry.npmjs.org"),
        ({"npm_config_registry": "https://a"}, "registry=https://b", "", "https://a"),
        ({"NPM_CONFIG_REGISTRY": "https://a"}, "", "", "https://a"),
        ({}, "# one\nregistry = https://b\n", "registry=https://c", "https://b"),
        ({}, "fund=false", "registry=https://c", "https://c"),
        ({}, "", "@scope:registry=https://d\nregistry=https://c", "https://d"),
        ({}, "", "@other:registry=https://d", "https://registry.npmjs.org"),
    ],
)
def test_the_registry_is_npms(
    tmp_path: Path, variables: dict[str, str], here: str, home: str, expected: str
) -> None:
    """The environment before .npmrc, that of the project before that of the user."""
    for name, text in (("here", here), ("home", home)):
        (tmp_path / name).mkdir()
        (tmp_path / name / ".npmrc").write_text(text)
    folders = [tmp_path / "here", tmp_path / "home", tmp_path / "missing"]
    assert find_registry(LIBRARY.name, variables, folders) == expected


def build(tmp_path: Path, version: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run the build hook where the library is missing and no registry answers."""
    code = (
        "import sys, pathlib; sys.path.insert(0, sys.argv[1]); from tools import npm;"
        "npm.FOLDER = pathlib.Path(sys.argv[2]);"
        "hook = npm.PageLibrary(sys.argv[2], {}, None, None, sys.argv[2], 'wheel');"
        "hook.initialize(sys.argv[3], {})"
    )
    return subprocess.run(
        [sys.executable, "-c", code, str(ROOT), str(tmp_path), version],
        env={**os.environ, "npm_config_registry": "http://127.0.0.1:1", **variables},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_a_wheel_without_the_library_is_not_built(tmp_path: Path) -> None:
    """Unless that is asked for; the error says both ways out."""
    done = build(tmp_path, "standard")
    assert done.returncode != 0
    assert f"cannot fetch {DAGRE.name} {DAGRE.version} from http://127.0.0.1:1/" in done.stderr
    assert "npm_config_registry" in done.stderr
    assert "RIGEL_WITHOUT_UI=1" in done.stderr
    assert build(tmp_path, "standard", RIGEL_WITHOUT_UI="1").returncode == 0


def test_a_checkout_is_installed_without_the_library(tmp_path: Path) -> None:
    """With a warning: it can be fetched later."""
    done = build(tmp_path, "editable")
    assert done.returncode == 0, done.stderr
    assert "warning: cannot fetch" in done.stderr
    assert "python tools/npm.py" in done.stderr

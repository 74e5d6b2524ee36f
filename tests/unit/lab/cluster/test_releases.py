"""Released programs: downloaded from their projects' servers or a mirror, and checked."""

from __future__ import annotations

import hashlib
import os
import socket
import tarfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import attrs
import pytest

from rigel_k8s.errors import LocalClusterError, UserError
from rigel_lab.cluster import components, download, releases
from rigel_lab.cluster.components import (
    CONTAINERD,
    COREDNS,
    GO_BUILDS,
    K3S_KUBELET,
    KUBERNETES,
    KUBERNETES_VERSION,
    LOCAL_PATH,
    MULTUS,
    ON_REQUEST,
    PLUGINS,
)
from rigel_lab.cluster.download import Patience, Server, Unavailable, find_sum
from rigel_lab.cluster.gobuild import GoBuild
from rigel_lab.cluster.observability import NODE_EXPORTER, PROMETHEUS
from rigel_lab.cluster.releases import Progress, Release, Upstream, place_of
from tests.support.release_server import Fault, Releases

FILES = [KUBERNETES, CONTAINERD, COREDNS, PLUGINS, PROMETHEUS, NODE_EXPORTER]
IMAGES = [LOCAL_PATH, MULTUS]
RELEASED = [*FILES, *IMAGES]
KUBERNETES_FILES = f"dl.k8s.io/release/v{KUBERNETES_VERSION}/bin/linux/amd64"
KUBELET = f"{KUBERNETES_FILES}/kubelet"
#: Seconds; the server is on loopback.
QUICK = Patience(connect=2, silence=0.3)


def content(build: GoBuild) -> dict[str, bytes]:
    """Small files by their names in a release."""
    return {name: f"{name} of {build.title}\n".encode() * 99 for name in build.in_release.values()}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, on a machine that releases call amd64."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("RIGEL_CLUSTER_MIRROR", raising=False)
    monkeypatch.setattr(releases, "architecture", lambda: "amd64")
    return tmp_path / "cache/rigel-k8s"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Releases]:
    """A mirror with everything that is released."""
    mirror = Releases(tmp_path / "mirror")
    for build in RELEASED:
        assert build.release
        mirror.publish(build.release, content(build))
    with mirror.serve():
        yield mirror


@pytest.fixture
def upstream(server: Releases) -> Upstream:
    """Downloads from the mirror, however busy this machine is."""
    return Upstream(server.url, Server(Patience(connect=30, silence=30)))


@pytest.fixture
def compiles(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """What would be compiled, and why; Debian's packages are there."""
    done: list[tuple[str, str]] = []

    def build(self: GoBuild, report: object, why: str = "") -> None:
        done.append((self.name, why))

    monkeypatch.setattr(GoBuild, "build", build)
    monkeypatch.setattr(components, "unpack", lambda report: None)
    return done


def left_behind(cache: Path) -> list[str]:
    """Every file in the cache."""
    return [str(path.relative_to(cache)) for path in cache.rglob("*") if path.is_file()]


@pytest.mark.parametrize("build", RELEASED, ids=lambda build: build.name)
def test_a_release_is_downloaded_and_checked(build: GoBuild, upstream: Upstream) -> None:
    """Programs and what goes with them are there under our names, and can be executed."""
    build.fetch(upstream, print)
    found = build.programs(upstream)
    assert list(found) == [*build.program_names, *build.files]
    for ours, there in build.in_release.items():
        assert Path(found[ours]).read_bytes() == content(build)[there]
    assert all(os.access(found[name], os.X_OK) for name in build.program_names)


@pytest.mark.parametrize(
    ("build", "url", "sums"),
    [
        (KUBERNETES, f"{KUBERNETES_FILES}/kube-apiserver", "{}.sha256"),
        (
            CONTAINERD,
            "github.com/containerd/containerd/releases/download/v2.4.2/"
            "containerd-static-2.4.2-linux-amd64.tar.gz",
            "{}.sha256sum",
        ),
        (
            COREDNS,
            "github.com/coredns/coredns/releases/download/v1.15.0/coredns_1.15.0_linux_amd64.tgz",
            "{}.sha256",
        ),
        (
            PLUGINS,
            "github.com/containernetworking/plugins/releases/download/v1.9.1/"
            "cni-plugins-linux-amd64-v1.9.1.tgz",
            "{}.sha256",
        ),
        (
            PROMETHEUS,
            "github.com/prometheus/prometheus/releases/download/v3.13.3/"
            "prometheus-3.13.3.linux-amd64.tar.gz",
            "sha256sums.txt",
        ),
        (
            NODE_EXPORTER,
            "github.com/prometheus/node_exporter/releases/download/v1.12.1/"
            "node_exporter-1.12.1.linux-amd64.tar.gz",
            "sha256sums.txt",
        ),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_upstreams_own_addresses(build: GoBuild, url: str, sums: str) -> None:
    """Where each project publishes: these are its addresses, not ours to choose."""
    assert isinstance(build.release, Release)
    file = build.release.files(build.in_release)[0]
    assert build.release.url(file) == f"https://{url}"
    assert build.release.sums.format(file=file) == sums.format(file)


@pytest.mark.parametrize("build", RELEASED, ids=lambda build: build.name)
def test_a_release_is_of_the_version_that_is_compiled(build: GoBuild) -> None:
    """Who moves to another version changes both."""
    assert f"v{build.version}" in repr(build.release)


def test_without_a_mirror_upstream_itself_is_asked() -> None:
    """A mirror has what upstream has, below its own URL."""
    assert Upstream().locate("https://dl.k8s.io/a") == "https://dl.k8s.io/a"
    assert Upstream("http://m/x").locate("https://dl.k8s.io/a") == "http://m/x/dl.k8s.io/a"


@pytest.mark.parametrize(
    ("option", "variable", "mirror"),
    [
        (None, "", ""),
        (None, "http://m:1/x/", "http://m:1/x"),
        ("http://n", "http://m", "http://n"),
        ("none", "http://m", "none"),
        (None, "none", "none"),
    ],
)
def test_the_option_wins_over_the_variable(option: str | None, variable: str, mirror: str) -> None:
    """--mirror, else RIGEL_CLUSTER_MIRROR, else upstream."""
    assert Upstream.of(option, {"RIGEL_CLUSTER_MIRROR": variable}).mirror == mirror


@pytest.mark.parametrize("text", ["m", "ftp://m", "/srv/mirror", "http://"])
def test_a_mirror_that_is_not_a_url(text: str) -> None:
    """A mirror that cannot be is refused before anything starts."""
    with pytest.raises(UserError, match="is not a URL"):
        Upstream.of(text, {})


def test_a_wrong_sum_is_an_error_and_nothing_is_kept(
    server: Releases, upstream: Upstream, cache: Path, compiles: list[tuple[str, str]]
) -> None:
    """Something else than was published: named, with both sums; not compiled instead."""
    (server.root / KUBELET).write_bytes(b"something else")
    with pytest.raises(
        LocalClusterError, match=r"amd64/kubelet does not match its published checksum"
    ) as caught:
        components.obtain(print, (), upstream)
    expected = hashlib.sha256(content(KUBERNETES)["kubelet"]).hexdigest()
    actual = hashlib.sha256(b"something else").hexdigest()
    assert [line.split()[-1] for line in caught.value.details] == [expected, actual]
    assert "--from-source" in (caught.value.hint or "")
    assert caught.value.exit_code == 1
    assert left_behind(cache) == []
    assert ("kubernetes", "") not in compiles


@pytest.mark.parametrize(
    ("fault", "silence", "why"),
    [
        ("truncated", 30, "amd64/kubelet broke"),
        ("stalls", 0.3, "sent nothing for 0.3 s"),
        ("silent", 0.3, "sent nothing for 0.3 s"),
    ],
)
def test_a_file_that_does_not_come_whole(
    server: Releases,
    cache: Path,
    compiles: list[tuple[str, str]],
    fault: Fault,
    silence: float,
    why: str,
) -> None:
    """It never counts, and its programs are compiled instead; the others are downloaded."""
    server.faults[KUBELET] = fault
    patience = Patience(connect=30, silence=silence)
    found = components.obtain(print, (), Upstream(server.url, Server(patience)))
    reasons = dict(compiles)
    assert why in reasons.pop("kubernetes")
    assert not [file for file in left_behind(cache) if "kube" in file or "part" in file]
    if fault == "truncated":
        assert Path(found.go["coredns"]).exists()
        assert not reasons


def test_a_server_that_is_not_there_is_asked_once(
    compiles: list[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One attempt for all programs of a server; the reason is told with each that is compiled."""
    attempts: list[object] = []
    connect = socket.create_connection

    def count(address: tuple[str, int], *words: float) -> socket.socket:
        attempts.append(address)
        return connect(address, *words)

    monkeypatch.setattr(download.socket, "create_connection", count)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    components.obtain(print, ["multus"], Upstream(f"http://127.0.0.1:{port}", Server(QUICK)))
    assert len(attempts) == 1
    reason = "cannot reach 127.0.0.1 (Connection refused)"
    assert ("kubernetes", reason) in compiles
    assert ("coredns", reason) in compiles
    assert ("cni-plugins", reason) in compiles


def test_a_name_server_that_hangs_costs_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Resolving a name has no time-out of its own."""

    over = threading.Event()

    def hang(*words: object) -> socket.socket:
        over.wait(120)
        raise socket.gaierror

    monkeypatch.setattr(download.socket, "create_connection", hang)
    try:
        start = time.monotonic()
        with pytest.raises(Unavailable, match=r"cannot reach dl.k8s.io \(no connection within"):
            Server(Patience(connect=0.05)).read_sum("https://dl.k8s.io/x.sha256", "x")
        assert time.monotonic() - start < 60
    finally:
        over.set()


def test_a_proxy_is_used(server: Releases, monkeypatch: pytest.MonkeyPatch) -> None:
    """What only a proxy can reach is asked of it, and its name is not looked up here."""
    monkeypatch.setenv("http_proxy", server.url)
    with pytest.raises(Unavailable, match=r"no\.such\.host/x: HTTP 404"):
        Server(Patience()).read("http://no.such.host/x")
    assert server.asked == ["http://no.such.host/x"]


def test_a_proxy_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs are compiled: Go's own tools may be able to use it."""
    monkeypatch.setenv("https_proxy", "socks5://proxy:1080")
    with pytest.raises(Unavailable, match=r"socks5://proxy is not supported"):
        Server(QUICK).read("https://no.such.host/x")


def test_what_is_not_released_for_this_machine(server: Releases, upstream: Upstream) -> None:
    """A file that is missing there is compiled; its server is asked for others still."""
    (server.root / f"{KUBELET}.sha256").unlink()
    with pytest.raises(Unavailable, match=r"kubelet.sha256: HTTP 404"):
        KUBERNETES.fetch(upstream, print)
    COREDNS.fetch(upstream, print)
    assert COREDNS.find(upstream)


@attrs.define
class Answer:
    """What a server answers: the file, or where it is."""

    location: str | None
    status: int = 200
    headers: dict[str, str] = attrs.field(factory=dict)

    def get_redirect_location(self) -> str | None:
        return self.location

    def read(self, most: int) -> bytes:
        return ONE.encode()


def redirect(monkeypatch: pytest.MonkeyPatch, places: dict[str, str | None]) -> None:
    """Let servers answer with redirections."""

    @contextmanager
    def ask(self: Server, url: str, headers: object) -> Iterator[Answer]:
        yield Answer(places[url])

    monkeypatch.setattr(Server, "ask", ask)


def test_releases_are_redirected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Release hosts keep their files elsewhere, and say so by a full or a short address."""
    places = {"https://a/x": "https://b/y?z", "https://b/y?z": "/w", "https://b/w": None}
    redirect(monkeypatch, places)
    assert Server().read_sum("https://a/x", "x") == ONE


@pytest.mark.parametrize(
    ("places", "why"),
    [
        ({"https://a/x": "http://a/x", "http://a/x": None}, "redirects from TLS"),
        ({"https://a/x": "https://a/x"}, "without end"),
    ],
)
def test_redirections_that_are_not_followed(
    monkeypatch: pytest.MonkeyPatch, places: dict[str, str | None], why: str
) -> None:
    """A sum that did not come over TLS proves nothing."""
    redirect(monkeypatch, places)
    with pytest.raises(Unavailable, match=why):
        Server().read_sum("https://a/x", "x")


def test_an_archive_that_lacks_a_program(server: Releases, upstream: Upstream, cache: Path) -> None:
    """A release of another content is compiled, and not used in part."""
    for build, gone in ((PLUGINS, "macvlan"), (MULTUS, "multus-shim")):
        assert build.release
        some = content(build)
        del some[gone]
        server.publish(build.release, some)
        with pytest.raises(Unavailable, match=rf"v{build.version}\S* has no {gone}"):
            build.fetch(upstream, print)
    assert left_behind(cache) == []


def test_an_archive_writes_nowhere_else(tmp_path: Path) -> None:
    """Only files that are wanted leave an archive, whatever path they have in it."""
    target = tmp_path / "target"
    target.mkdir()
    file = target / "a.tgz"
    with tarfile.open(file, "w:gz") as tar:
        link = tarfile.TarInfo("link/coredns")
        link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
        tar.addfile(link)
        for name in ("../../evil", "/etc/evil", "../coredns"):
            tar.addfile(tarfile.TarInfo(name))
    releases.unpack(file, {"coredns": "coredns"}, target)
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["coredns"]
    assert (target / "coredns").read_bytes() == b""


def test_programs_that_are_there_are_not_downloaded_again(
    server: Releases,
    upstream: Upstream,
    compiles: list[tuple[str, str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second `up` asks no server for what the first one downloaded, and compiles nothing."""
    first = components.obtain(print, (), upstream)
    monkeypatch.setattr(components, "find_missing_packages", list)
    monkeypatch.setattr(components, "provide", lambda *words: pytest.fail("all is there"))
    assert components.obtain(print, (), upstream) == first


def test_who_waited_for_another_download_uses_it(server: Releases, upstream: Upstream) -> None:
    """Two commands at once: the second one finds what the first one brought."""
    COREDNS.fetch(upstream, print)
    asked = len(server.asked)
    COREDNS.fetch(upstream, print)
    assert len(server.asked) == asked > 0


def test_a_part_of_a_file_does_not_stay(server: Releases, tmp_path: Path) -> None:
    """Neither under its name nor under another."""
    server.faults[KUBELET] = "truncated"
    target = tmp_path / "target"
    target.mkdir()
    with pytest.raises(Unavailable, match="kubelet broke"):
        Server(QUICK).save(f"{server.url}/{KUBELET}", target / "kubelet", ONE, lambda *_: None)
    assert list(target.iterdir()) == []


def test_what_a_download_left_does_not_count(upstream: Upstream, cache: Path) -> None:
    """A download that was killed begins again."""
    place = COREDNS.released
    work = place.with_name(f".{place.name}")
    work.mkdir(parents=True)
    (work / "coredns").write_text("half")
    assert COREDNS.find(upstream) is None
    COREDNS.fetch(upstream, print)
    assert (place / "coredns").read_bytes() == content(COREDNS)["coredns"]
    assert not work.exists()


def test_from_source_everything_is_compiled(
    server: Releases, upstream: Upstream, compiles: list[tuple[str, str]]
) -> None:
    """Nothing is downloaded, and what was downloaded before is not used either."""
    components.obtain(print, (), upstream)
    asked = len(server.asked)
    compiles.clear()
    found = components.obtain(print, (), Upstream("none"))
    names = ("kubernetes", "containerd", "coredns", "local-path-provisioner")
    assert sorted(compiles) == sorted((name, "") for name in names)
    assert found.go["kubelet"] == str(KUBERNETES.directory / "kubelet")
    assert len(server.asked) == asked


def test_downloaded_and_compiled_programs_are_kept_apart(upstream: Upstream, cache: Path) -> None:
    """Each kind has a directory of its own; what was compiled here is used where both are."""
    COREDNS.fetch(upstream, print)
    downloaded = COREDNS.find(upstream)
    assert downloaded
    assert downloaded.parent == cache / "released"
    assert COREDNS.directory.parent == cache / "go"
    COREDNS.directory.mkdir(parents=True)
    assert COREDNS.find(upstream) == COREDNS.directory
    assert COREDNS.find(Upstream("none")) == COREDNS.directory


def test_another_release_is_another_directory() -> None:
    """Another version, archive or list of programs is not taken for this one."""
    assert PLUGINS.release
    wanted = PLUGINS.in_release
    places = {
        place_of(PLUGINS.release, "a", "1", wanted),
        place_of(PLUGINS.release, "a", "2", wanted),
        place_of(PLUGINS.release, "a", "1", {"bridge": "bridge"}),
        place_of(attrs.evolve(PLUGINS.release, archive="b"), "a", "1", wanted),
    }
    assert len(places) == 4


def test_only_upstreams_own_programs_are_downloaded() -> None:
    """The kubelet of k3s is changed, which no project releases."""
    assert K3S_KUBELET.release is None
    every = [*GO_BUILDS, *(build for builds in ON_REQUEST.values() for build in builds)]
    assert all(build.release is None for build in every if build.stamps and build.suffix)


def test_compiling_says_why_and_how_long(monkeypatch: pytest.MonkeyPatch, cache: Path) -> None:
    """One line: what cannot be reached, what is compiled instead, how long that takes."""
    monkeypatch.setattr(GoBuild, "_build", lambda self, report: None)
    lines: list[str] = []
    KUBERNETES.build(lines.append, "cannot reach dl.k8s.io (no route)")
    LOCAL_PATH.build(lines.append)
    assert lines == [
        f"cannot reach dl.k8s.io (no route): compiling kubernetes {KUBERNETES_VERSION} from source"
        " (about 8 minutes on two cores, once)",
        "Compiling local-path-provisioner 0.0.37 from source (about 2 minutes on two cores, once)",
    ]


def test_a_long_download_reports_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once when the server sends something, and then in megabytes, now and then."""
    monkeypatch.setattr(releases, "REPORT_EVERY", -1)
    lines: list[str] = []
    progress = Progress("x", "dl.k8s.io", lines.append, "kubelet")
    progress.count(12_000_000, 57_000_000)
    progress.count(12_000_000, 0)
    assert lines == [
        "Downloading x from dl.k8s.io",
        "Downloading x: kubelet, 12 of 57 MB",
        "Downloading x: kubelet, 12 MB",
    ]


ONE, OTHER = "a" * 64, "B" * 64


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (ONE, ONE),
        (f"{ONE}\n", ONE),
        (f"{ONE}  f.tgz\n", ONE),
        (f"{ONE} *f.tgz\n", ONE),
        (f"{ONE}  release/f.tgz\n", ONE),
        (f"{ONE}  g.tgz\n{OTHER}  f.tgz\n", OTHER.lower()),
        (f"{ONE}  g.tgz\n", ""),
        (f"{ONE}  xf.tgz\n", ""),
        ("<html>log in</html>", ""),
        ("", ""),
    ],
)
def test_lists_of_sums(text: str, expected: str) -> None:
    """Kubernetes publishes a sum alone, others lists as `sha256sum` prints them."""
    assert find_sum(text, "f.tgz") == expected


def test_a_registry_that_wants_a_token(server: Releases, upstream: Upstream) -> None:
    """Public registries give one to anonymous users."""
    server.logins = True
    (server.root / "token").write_text('{"token": "t"}')
    LOCAL_PATH.fetch(upstream, print)
    assert "/token?service=images" in server.asked
    assert Path(LOCAL_PATH.programs(upstream)["local-path-provisioner"]).exists()


def test_a_registry_that_gives_no_token(server: Releases, upstream: Upstream) -> None:
    """What it keeps for itself is compiled."""
    server.logins = True
    (server.root / "token").write_text("no")
    with pytest.raises(Unavailable, match="gives no token"):
        LOCAL_PATH.fetch(upstream, print)


def test_only_the_layers_that_are_needed_are_downloaded(
    server: Releases, upstream: Upstream
) -> None:
    """Below the programs is a distribution, which may be large."""
    LOCAL_PATH.fetch(upstream, print)
    assert len([path for path in server.asked if "/blobs/" in path]) == 1


@pytest.mark.parametrize("kind", ["blobs", "manifests"])
def test_an_image_that_is_not_what_its_digest_says(
    server: Releases, upstream: Upstream, cache: Path, kind: str
) -> None:
    """Nothing of it is used."""
    assert LOCAL_PATH.release
    for file in (server.path(LOCAL_PATH.release.origin) / kind).glob("sha256:*"):
        file.write_bytes(file.read_bytes() + b" ")
    with pytest.raises((LocalClusterError, Unavailable), match=r"does not match"):
        LOCAL_PATH.fetch(upstream, print)
    assert left_behind(cache) == []


def test_an_image_for_other_machines(
    server: Releases, upstream: Upstream, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its programs are compiled."""
    monkeypatch.setattr(releases, "architecture", lambda: "riscv64")
    with pytest.raises(Unavailable, match="is not an image for this machine"):
        LOCAL_PATH.fetch(upstream, print)


def test_a_list_without_the_file(server: Releases, upstream: Upstream) -> None:
    """What has no published sum is not used."""
    (server.root / f"{KUBELET}.sha256").write_text("<html>log in first</html>")
    with pytest.raises(Unavailable, match="has no SHA-256 sum of kubelet"):
        KUBERNETES.fetch(upstream, print)

"""Released programs: downloaded from their projects' servers or a mirror, and checked."""

from __future__ import annotations

import hashlib
import os
import socket
import tarfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import attrs
import pytest
import urllib3
from urllib3.util.retry import RequestHistory

from rigel_k8s.errors import LocalClusterError, UserError
from rigel_lab.cluster import components, releases
from rigel_lab.cluster.components import BUILDS, GO_BUILDS, KUBERNETES_VERSION, ON_REQUEST
from rigel_lab.cluster.gobuild import GoBuild
from rigel_lab.cluster.releases import Progress, Unavailable, Upstream, find_sum
from tests.support.release_server import Fault, Releases

CONTAINERD = BUILDS["containerd"]
COREDNS = BUILDS["coredns"]
K3S_KUBELET = BUILDS["k3s"]
KUBERNETES = BUILDS["kubernetes"]
LOCAL_PATH = BUILDS["local-path-provisioner"]
PLUGINS = BUILDS["cni-plugins"]
NODE_EXPORTER = BUILDS["node-exporter"]
PROMETHEUS = BUILDS["prometheus"]

RELEASED = [KUBERNETES, CONTAINERD, COREDNS, PLUGINS, PROMETHEUS, NODE_EXPORTER]
KUBERNETES_FILES = f"dl.k8s.io/release/v{KUBERNETES_VERSION}/bin/linux/amd64"
KUBELET = f"{KUBERNETES_FILES}/kubelet"


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
    return Upstream(server.url, silence=30)


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
    assert build.release
    file = build.release.list_files(build.in_release)[0]
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
    ("variable", "mirror"), [("", ""), ("http://m:1/x/", "http://m:1/x"), ("none", "none")]
)
def test_the_variable_names_the_mirror(variable: str, mirror: str) -> None:
    """RIGEL_CLUSTER_MIRROR, else upstream."""
    assert Upstream.of({"RIGEL_CLUSTER_MIRROR": variable}).mirror == mirror


@pytest.mark.parametrize("text", ["m", "ftp://m", "/srv/mirror", "http://"])
def test_a_mirror_that_is_not_a_url(text: str) -> None:
    """A mirror that cannot be is refused before anything starts."""
    with pytest.raises(UserError, match="is not a URL"):
        Upstream.of({"RIGEL_CLUSTER_MIRROR": text})


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
    assert "RIGEL_CLUSTER_MIRROR=none" in (caught.value.hint or "")
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
    found = components.obtain(print, (), Upstream(server.url, silence))
    reasons = dict(compiles)
    assert why in reasons.pop("kubernetes")
    assert not [file for file in left_behind(cache) if "kube" in file or "part" in file]
    if fault == "truncated":
        assert Path(found.go["coredns"]).exists()
        assert reasons == {"local-path-provisioner": ""}


def test_a_server_that_is_not_there_is_asked_once(
    compiles: list[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One attempt for all programs of a server; the reason is told with each that is compiled."""
    attempts: list[str] = []
    connect = Upstream.connect

    def count(self: Upstream, url: str) -> urllib3.PoolManager:
        attempts.append(url)
        return connect(self, url)

    monkeypatch.setattr(Upstream, "connect", count)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    components.obtain(print, ["multus"], Upstream(f"http://127.0.0.1:{port}"))
    assert len(attempts) == 1
    reason = f"cannot reach 127.0.0.1:{port} (Connection refused)"
    assert ("kubernetes", reason) in compiles
    assert ("coredns", reason) in compiles
    assert ("cni-plugins", reason) in compiles


def test_a_proxy_is_used(server: Releases, monkeypatch: pytest.MonkeyPatch) -> None:
    """What only a proxy can reach is asked of it, and its name is not looked up here."""
    monkeypatch.setenv("http_proxy", server.url)
    with pytest.raises(Unavailable, match=r"no\.such\.host/x: HTTP 404"):
        Upstream().read_sum("http://no.such.host/x", "x")
    assert server.asked == ["http://no.such.host/x"]


def test_a_proxy_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs are compiled: Go's own tools may be able to use it."""
    monkeypatch.setenv("https_proxy", "socks5://proxy:1080")
    with pytest.raises(Unavailable, match=r"socks5"):
        Upstream().read_sum("https://no.such.host/x", "x")


def test_what_is_not_released_for_this_machine(server: Releases, upstream: Upstream) -> None:
    """A file that is missing there is compiled; its server is asked for others still."""
    (server.root / f"{KUBELET}.sha256").unlink()
    with pytest.raises(Unavailable, match=r"kubelet.sha256: HTTP 404"):
        KUBERNETES.fetch(upstream, print)
    COREDNS.fetch(upstream, print)
    assert COREDNS.find(upstream)


def test_releases_are_redirected(server: Releases, upstream: Upstream) -> None:
    """Release hosts keep their files elsewhere, and say so."""
    server.faults[KUBELET] = "moved"
    KUBERNETES.fetch(upstream, print)
    assert f"/{KUBELET}?moved" in server.asked


@attrs.define
class Redirected:
    """A pool whose answers come after redirections."""

    places: tuple[str, ...]

    def request(self, *_: object, **__: object) -> urllib3.HTTPResponse:
        """Answer with the sum that is expected."""
        history = tuple(RequestHistory("GET", None, None, 302, place) for place in self.places)
        retries = urllib3.Retry(history=history)
        body = BytesIO(ONE.encode())
        return urllib3.HTTPResponse(body, status=200, retries=retries, preload_content=False)


def test_a_sum_that_did_not_come_over_tls_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that did counts, wherever it was."""
    places: tuple[str, ...] = ("https://b/y", "/w")
    monkeypatch.setattr(Upstream, "connect", lambda self, url: Redirected(places))
    assert Upstream().read_sum("https://a/x", "x") == ONE
    places = ("https://b/y", "http://b/y", "https://c/y")
    with pytest.raises(Unavailable, match="redirects from TLS to http://b/y"):
        Upstream().read_sum("https://a/x", "x")


def test_redirections_without_end(server: Releases, upstream: Upstream) -> None:
    """They end after a few, and the programs are compiled."""
    server.faults[KUBELET] = server.faults[f"{KUBELET}?moved"] = "moved"
    with pytest.raises(Unavailable, match="redirects without end"):
        KUBERNETES.fetch(upstream, print)


def test_an_archive_that_lacks_a_program(server: Releases, upstream: Upstream, cache: Path) -> None:
    """A release of another content is compiled, and not used in part."""
    assert PLUGINS.release
    some = content(PLUGINS)
    del some["macvlan"]
    server.publish(PLUGINS.release, some)
    with pytest.raises(Unavailable, match=rf"v{PLUGINS.version}\S* has no macvlan"):
        PLUGINS.fetch(upstream, print)
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
    LOCAL_PATH.directory.mkdir(parents=True)  # which was compiled
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
        PLUGINS.release.place("a", "1", wanted),
        PLUGINS.release.place("a", "2", wanted),
        PLUGINS.release.place("a", "1", {"bridge": "bridge"}),
        attrs.evolve(PLUGINS.release, archive="b").place("a", "1", wanted),
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
    progress = Progress("x", "dl.k8s.io", lines.append)
    progress.count("kubelet", 12_000_000, 57_000_000)
    progress.count("kubelet", 12_000_000, 0)
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


def test_a_list_without_the_file(server: Releases, upstream: Upstream) -> None:
    """What has no published sum is not used."""
    (server.root / f"{KUBELET}.sha256").write_text("<html>log in first</html>")
    with pytest.raises(Unavailable, match="has no SHA-256 sum of kubelet"):
        KUBERNETES.fetch(upstream, print)

"""What is built, and from what."""

from __future__ import annotations

import re
from pathlib import Path

import attrs
import pytest

from rigel_lab.cluster import components, gobuild
from rigel_lab.cluster.components import GO_BUILDS, KUBERNETES_VERSION, ON_REQUEST, Components
from rigel_lab.cluster.gobuild import GoBuild, Progress, go_version, toolchain
from rigel_lab.cluster.releases import Upstream

COREDNS = components.BUILDS["coredns"]
K3S_KUBELET = components.BUILDS["k3s"]
KUBERNETES = components.BUILDS["kubernetes"]
MULTUS = components.BUILDS["multus"]
WHEREABOUTS = components.BUILDS["whereabouts"]

BUILDS = [*GO_BUILDS, *(build for builds in ON_REQUEST.values() for build in builds)]


@pytest.mark.parametrize("build", BUILDS, ids=lambda build: build.name)
def test_the_lock_files_pin_the_version(build: GoBuild) -> None:
    """The version that we tell is the one that go.mod requires; go.sum has its hash."""
    required = f"{build.module} v{build.module_version}"
    assert required in (build.lock / "go.mod").read_text()
    assert required in (build.lock / "go.sum").read_text()


@pytest.mark.parametrize("build", BUILDS, ids=lambda build: build.name)
def test_the_toolchain_of_pypi_is_new_enough(build: GoBuild) -> None:
    """No go.mod asks for a newer Go than the oldest that we accept."""
    lines = (build.lock / "go.mod").read_text().splitlines()
    wanted = next(line.split()[1] for line in lines if line.startswith("go "))
    assert tuple(map(int, wanted.split("."))) <= gobuild.GO_VERSION
    offered = gobuild.GO_LOCK.read_text().split()[0].partition("==")[2]
    assert tuple(map(int, offered.split("."))) >= gobuild.GO_VERSION


def test_what_is_built_changes_where_it_is_kept() -> None:
    """Another version, tag or package is another directory of the cache."""
    builds = [
        COREDNS,
        attrs.evolve(COREDNS, version="1.15.1"),
        attrs.evolve(COREDNS, tags="x"),
        attrs.evolve(COREDNS, packages=("example.org/x",)),
        attrs.evolve(COREDNS, renamed={"coredns": "dns"}),
        attrs.evolve(COREDNS, files={"licence": "LICENSE"}),
        attrs.evolve(COREDNS, stamps=("x.y=z",)),
    ]
    assert len({build.key() for build in builds}) == len(builds)


def test_kubernetes_tells_its_version() -> None:
    """The flags stamp the version into what `kubectl version` reads."""
    flags = " ".join(KUBERNETES.flags())
    _, minor, _ = KUBERNETES_VERSION.split(".")
    assert f"-X k8s.io/component-base/version.gitVersion=v{KUBERNETES_VERSION}" in flags
    assert f"-X k8s.io/client-go/pkg/version.gitMinor={minor} " in flags


@pytest.mark.parametrize("page", ["README.md", "docs/what-was-run.md"])
def test_the_pages_name_the_version_that_runs(page: str) -> None:
    """Both name one version of Kubernetes as tested: that of the local cluster."""
    text = (Path(__file__).parents[4] / page).read_text("utf-8")
    assert set(re.findall(r"Kubernetes (\d+\.\d+\.\d+)", text)) == {KUBERNETES_VERSION}


def test_a_kubelet_of_k3s_says_so_and_is_the_same_program() -> None:
    """Only the version that it tells differs; it takes the plain one's place."""
    assert f"gitVersion=v{KUBERNETES_VERSION}+k3s1" in " ".join(K3S_KUBELET.flags())
    assert (K3S_KUBELET.lock, K3S_KUBELET.version) == (KUBERNETES.lock, KUBERNETES.version)
    assert set(K3S_KUBELET.programs()) == {"kubelet"}


def test_another_lock_file_is_another_build(tmp_path: Path) -> None:
    """A module's new hash is compiled, not overlooked in the cache."""

    class Moved(GoBuild):
        lock = tmp_path

    build = Moved("hello", "1.0.0", ("robot.example/hello",))
    keys = set()
    for text in ("h1:one", "h1:two"):
        (tmp_path / "go.sum").write_text(text)
        keys.add(build.key())
    assert len(keys) == 2


def test_programs_have_upstreams_names() -> None:
    """What is built of a directory `cmd` is called as upstream's build calls it."""
    assert WHEREABOUTS.program_names[:2] == ["whereabouts", "ip-control-loop"]
    assert "passthru" in MULTUS.program_names
    assert WHEREABOUTS.programs()["lib.sh"].endswith("/lib.sh")


def fake_go(directory: Path, version: str) -> Path:
    go = directory / "go"
    go.write_text(f"#!/bin/sh\necho {version}\n")
    go.chmod(0o755)
    return go


@pytest.mark.programs
@pytest.mark.parametrize(
    ("told", "version"),
    [("go1.26.8", (1, 26, 8)), ("go1.27", (1, 27, 0)), ("go1.27rc1", (1, 27, 0)), ("devel", (0,))],
)
def test_go_versions(tmp_path: Path, told: str, version: tuple[int, ...]) -> None:
    """A toolchain's version is what it says itself."""
    assert go_version(str(fake_go(tmp_path, told))) == version


@pytest.mark.programs
def test_an_old_go_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the machine's Go is too old, PyPI's is, with caches of its own."""
    fake_go(tmp_path, "go1.19.8")
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(gobuild, "fetch_toolchain", lambda report: "of PyPI")
    go, environment = toolchain(print)
    assert go == "of PyPI"
    assert environment["GOCACHE"] == f"{tmp_path}/rigel-k8s/go-build"


def test_progress_counts_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """A long build reports how far it is; other lines of the build are not counted."""
    monkeypatch.setattr(gobuild, "REPORT_EVERY", -1)
    told: list[str] = []
    progress = Progress("x", 9, told.append)
    for line in ("k8s.io/api/core/v1", "go: downloading k8s.io/api v0.34.4", "runtime"):
        progress.count(line)
    assert told[-1] == "Building x: 2 of 9 packages"


def test_kubectl_is_built_on_request_alone() -> None:
    """No cluster needs it, and one of the very same version can be asked for."""
    assert "kubectl" not in KUBERNETES.program_names
    [kubectl] = ON_REQUEST["kubectl"]
    assert kubectl.program_names == ["kubectl"]
    assert (kubectl.lock, kubectl.flags()) == (KUBERNETES.lock, KUBERNETES.flags())


def test_programs_that_are_gone_are_replaced(tmp_path: Path) -> None:
    """A running cluster keeps its programs, but for those whose cache was cleared."""
    kept, new = tmp_path / "kept", tmp_path / "new"
    kept.touch()
    old = Components({"kubelet": str(kept), "coredns": str(tmp_path / "gone")}, "/debian")
    now = Components({"kubelet": str(new), "coredns": str(new)}, "/other")
    assert old.replace_missing(now) == Components(
        {"kubelet": str(kept), "coredns": str(new)}, "/debian"
    )


def test_a_cleared_cache_is_noticed(tmp_path: Path) -> None:
    """Components whose programs were deleted are not complete."""
    assert not Components({"kubelet": str(tmp_path / "kubelet")}, str(tmp_path)).complete


@pytest.mark.parametrize(
    ("requested", "more"),
    [
        ([], []),
        (["multus"], ["multus", "whereabouts", "cni-plugins"]),
        (
            ["observability"],
            [
                "loki",
                "otel-collector",
                "prometheus",
                "kube-state-metrics",
                "node-exporter",
            ],
        ),
        (["promtail"], ["promtail"]),
        (["prometheus-operator"], ["prometheus-operator"]),
    ],
)
def test_only_what_is_asked_for_is_built(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, requested: list[str], more: list[str]
) -> None:
    """A cluster needs four builds; each extra adds its own."""
    built: list[str] = []
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(components, "unpack", lambda report: None)
    monkeypatch.setattr(GoBuild, "build", lambda self, report, why: built.append(self.name))
    found = components.obtain(print, requested, Upstream("none"))
    always = ["kubernetes", "containerd", "coredns", "local-path-provisioner"]
    assert sorted(built) == sorted([*always, *more])
    assert ("loki" in found.go) == (requested == ["observability"])


def test_the_total_of_what_is_compiled_is_reported_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who waits for several programs knows at the start how long all of them take."""
    monkeypatch.setattr(GoBuild, "build", lambda self, report, why: report(self.name))
    lines: list[str] = []
    components.compile_all([(KUBERNETES, "no network"), (COREDNS, "")], lines.append)
    minutes = KUBERNETES.minutes + COREDNS.minutes
    assert f"{KUBERNETES.title}, {COREDNS.title} (about {minutes} minutes" in lines[0]
    assert lines[1:] == ["kubernetes", "coredns"]
    lines.clear()
    components.compile_all([(COREDNS, "")], lines.append)
    assert lines == ["coredns"]

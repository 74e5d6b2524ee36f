"""The programs of a local cluster, and how they get into the cache.

Go programs are downloaded if their projects release them, and compiled if that server is
unreachable; the rest comes from Debian packages that are downloaded and unpacked, never installed:
installing them would start services and could displace Docker's containerd. This module is
independent of clusters.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import attrs
import yaml

from rigel_k8s.errors import CommandFailed, LocalClusterError
from rigel_k8s.system.cache import cache_dir, locked
from rigel_k8s.yaml_text import Loader
from rigel_lab.cluster.commands import Report, run
from rigel_lab.cluster.gobuild import GoBuild
from rigel_lab.cluster.releases import Release, Unavailable, Upstream


def _read_builds() -> Iterator[tuple[str, GoBuild]]:
    text = Path(__file__).with_name("programs.yaml").read_text("utf-8")
    for key, written in yaml.load(text, Loader).items():
        spec = json.loads(json.dumps(written).replace("VERSION", written["version"]))
        release = spec.pop("release", None)
        fields = {name: tuple(v) if isinstance(v, list) else v for name, v in spec.items()}
        published = Release(**release) if release else None
        yield key, GoBuild(**{"name": key, **fields}, release=published)


#: The programs of programs.yaml by their names there.
BUILDS = dict(_read_builds())
KUBERNETES_VERSION = BUILDS["kubernetes"].version
#: What every cluster needs.
GO_BUILDS = tuple(
    BUILDS[name] for name in ("kubernetes", "containerd", "coredns", "local-path-provisioner")
)
#: Needed only on request, by name; a program replaces one of the same name.
ON_REQUEST = {
    request: tuple(BUILDS[name] for name in names)
    for request, names in {
        "kubectl": ["kubectl"],
        "multus": ["multus", "whereabouts", "cni-plugins"],
        "observability": [
            *("loki", "otel-collector", "prometheus", "kube-state-metrics", "node-exporter"),
        ],
        "promtail": ["promtail"],
        "prometheus-operator": ["prometheus-operator"],
        "k3s": ["k3s"],
    }.items()
}

DEBIAN_PACKAGES = (
    "etcd-server",
    "runc",
    "containernetworking-plugins",
    "docker-registry",
    "catatonit",
    "busybox-static",
)


@attrs.frozen
class Components:
    """Where the programs are: Go programs by name in `go`, Debian's files below `prefix`."""

    go: dict[str, str]
    prefix: str

    @property
    def path(self) -> list[str]:
        """The directories of containerd's and of Debian's programs, for $PATH."""
        containerd = str(Path(self.program("containerd")).parent)
        return [containerd, f"{self.prefix}/usr/bin", f"{self.prefix}/usr/sbin"]

    @property
    def cni_plugins(self) -> Path:
        """The directory of the standard CNI programs."""
        return Path(self.prefix, "usr/lib/cni")

    @property
    def complete(self) -> bool:
        """Whether the Go programs still exist; a user who clears the cache removes all of it."""
        return all(Path(program).exists() for program in self.go.values())

    def replace_missing(self, others: Components) -> Components:
        """Return these programs, with others in the place of those that no longer exist."""
        there = {name: path for name, path in self.go.items() if Path(path).exists()}
        return attrs.evolve(self, go=others.go | there)

    def program(self, name: str) -> str:
        """Return the path of a program by its name.

        Raises:
            LocalClusterError: no package contains it.
        """
        if name in self.go:
            return self.go[name]
        for directory in ("usr/bin", "usr/sbin", "bin", "sbin"):
            if (path := Path(self.prefix, directory, name)).exists():
                return str(path)
        raise LocalClusterError(
            f"{name} is missing below {self.prefix}", hint=f"remove {self.prefix} and try again"
        )


def names(requested: Iterable[str]) -> set[str]:
    """Return the names of the programs and files of some names of ON_REQUEST."""
    builds = [build for name in requested for build in ON_REQUEST[name]]
    return {name for build in builds for name in build.in_release}


def obtain(
    report: Report, requested: Iterable[str] = (), upstream: Upstream | None = None
) -> Components:
    """Return all programs; missing ones are downloaded into the cache, or compiled.

    Args:
        report: called with one line for each step.
        requested: names of ON_REQUEST, whose programs are added.
        upstream: from where; None: as the environment sets it.

    Raises:
        LocalClusterError, CommandFailed: a build or a download failed.
    """
    upstream = upstream or Upstream.of()
    builds = [*GO_BUILDS, *(build for name in requested for build in ON_REQUEST[name])]
    missing = [build for build in builds if not build.find(upstream)]
    if missing or find_missing_packages():
        provide(missing, upstream, report)
    return Components(
        {name: path for build in builds for name, path in build.programs(upstream).items()},
        str(cache_dir() / "debian"),
    )


def provide(builds: Sequence[GoBuild], upstream: Upstream, report: Report) -> None:
    """Put programs and Debian packages into the cache.

    Programs that must be compiled anyway are compiled while the network delivers the rest.
    """
    with ThreadPoolExecutor(max_workers=1) as beside:
        compiled = beside.submit(compile_all, [(b, "") for b in builds if not b.release], report)
        with locked(cache_dir() / "debian.lock"):
            unpack(report)
        left = []
        for build in (build for build in builds if build.release):
            try:
                build.fetch(upstream, report)
            except Unavailable as error:
                left.append((build, str(error)))
        compiled.result()
    compile_all(left, report)


def compile_all(builds: Iterable[tuple[GoBuild, str]], report: Report) -> None:
    """Compile programs, one after the other: each build uses all cores; report why, if known."""
    builds = list(builds)
    if len(builds) > 1:
        titles = ", ".join(build.title for build, _ in builds)
        minutes = sum(build.minutes for build, _ in builds)
        report(f"To be compiled: {titles} (about {minutes} minutes on two cores in all, once)")
    for build, why in builds:
        build.build(report, why)


def find_missing_packages() -> list[str]:
    """Return the Debian packages that the cache does not have."""
    done = cache_dir() / "debian" / ".packages"
    return [package for package in DEBIAN_PACKAGES if not (done / package).exists()]


def unpack(report: Report) -> None:
    """Download and unpack the missing Debian packages."""
    if not (missing := find_missing_packages()):
        return
    require_apt()
    report(f"Downloading {', '.join(missing)}")
    target = cache_dir() / "debian"
    downloads = target.with_name(".downloads")
    shutil.rmtree(downloads, ignore_errors=True)
    downloads.mkdir()
    download(missing, downloads)
    for package in sorted(downloads.glob("*.deb")):
        run(["dpkg-deb", "-x", str(package), str(target)])
    (target / ".packages").mkdir(exist_ok=True)
    for name in missing:
        (target / ".packages" / name).touch()
    shutil.rmtree(downloads)


def require_apt() -> None:
    """Refuse a machine without Debian's packages."""
    if not (shutil.which("apt-get") and shutil.which("dpkg-deb")):
        raise LocalClusterError(
            "the local cluster takes etcd and runc from Debian's or Ubuntu's packages, and"
            " this machine has no apt-get",
            hint="use kind, minikube or k3s; rigel works with any cluster of your kubeconfig",
        )


def download(packages: Sequence[str], into: Path) -> None:
    """Download packages; package lists that are missing or old are renewed once."""
    command = ["apt-get", "download", "-q", "-o", "APT::Sandbox::User=root", *packages]
    try:
        run(command, cwd=into)
    except CommandFailed:
        run(["apt-get", "update", "-q"])
        run(command, cwd=into)

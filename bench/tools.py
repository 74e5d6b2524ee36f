"""The three ways to deploy the same objects: rigel, kubectl, helm."""

from __future__ import annotations

import compileall
import functools
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import attrs

from rigel_lab.cluster import gobuild

Command = Sequence[str]
CHECKOUT = Path(__file__).parents[1]


class Tool(Protocol):
    """A way to deploy, in a namespace of its own."""

    name: str
    namespace: str

    def deploy(self, rigelfile: Path) -> list[Command]:
        """Return the commands that deploy a Rigelfile's objects and wait until they are ready."""


def rigel(context: str, namespace: str, rigelfile: Path, *words: str) -> list[str]:
    """Return a command line of rigel."""
    return [*program(), "-f", str(rigelfile), "--context", context, "-n", namespace, *words]


def program(checkout: Path | None = None) -> list[str]:
    """Return the command `rigel` of this checkout, or of another one."""
    compile_modules(checkout or CHECKOUT)
    source = ["env", f"PYTHONPATH={checkout / 'src'}"] if checkout else []
    return [*source, sys.executable, "-m", "rigel_k8s"]


@functools.cache
def compile_modules(checkout: Path) -> None:
    """Compile the modules of a checkout, as an installation compiles them.

    Where PYTHONDONTWRITEBYTECODE is set, each start of a checkout compiles all that it imports.
    """
    compileall.compile_dir(checkout / "src", quiet=2)


@attrs.frozen
class Rigel:
    """`rigel run job deploy`."""

    context: str
    namespace: str = "bench-rigel"
    name: str = "rigel"
    checkout: Path | None = None

    def deploy(self, rigelfile: Path) -> list[Command]:
        """Deploy."""
        where = ["-f", str(rigelfile), "--context", self.context, "-n", self.namespace]
        return [[*program(self.checkout), *where, "run", "job", "deploy"]]


def render(context: str, namespace: str, rigelfile: Path) -> str:
    """Return the manifests that rigel would apply in a namespace."""
    command = rigel(context, namespace, rigelfile, "render", "deploy")
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@attrs.frozen
class Kubectl:
    """`kubectl apply --server-side` and `kubectl rollout status`."""

    context: str
    program: str
    namespace: str = "bench-kubectl"
    name: str = "kubectl"

    def deploy(self, rigelfile: Path) -> list[Command]:
        """Deploy the rendered manifests."""
        path = rigelfile.with_suffix(f".{self.name}.yaml")
        path.write_text(render(self.context, self.namespace, rigelfile))
        head = [self.program, "--context", self.context, "-n", self.namespace]
        selector = "app.kubernetes.io/managed-by=rigel"
        return [
            [*head, "apply", "--server-side", "-f", str(path)],
            [*head, "rollout", "status", "deployment", "-l", selector, "--timeout=600s"],
        ]


@attrs.frozen
class Helm:
    """`helm upgrade --install --wait` of a chart with the rendered manifests."""

    context: str
    program: str
    namespace: str = "bench-helm"
    name: str = "helm"

    def deploy(self, rigelfile: Path) -> list[Command]:
        """Deploy the rendered manifests as a chart."""
        chart = rigelfile.with_suffix(".chart")
        (chart / "templates").mkdir(parents=True, exist_ok=True)
        (chart / "Chart.yaml").write_text("apiVersion: v2\nname: bench\nversion: 0.1.0\n")
        text = render(self.context, self.namespace, rigelfile)
        (chart / "files").mkdir(exist_ok=True)
        (chart / "files" / "all.yaml").write_text(text)
        (chart / "templates" / "all.yaml").write_text('{{ .Files.Get "files/all.yaml" }}\n')
        head = [self.program, "--kube-context", self.context, "-n", self.namespace]
        return [[*head, "upgrade", "--install", "--wait", "--timeout", "600s", "bench", str(chart)]]


@attrs.frozen
class BenchBuild(gobuild.GoBuild):
    """A Go program that only the bench needs; its lock file is here."""

    @property
    def lock(self) -> Path:
        """The directory of its go.mod and go.sum."""
        return Path(__file__).parent / self.name


def helm_program() -> str:
    """Return helm, built from its Go module if it is not in the cache."""
    build = BenchBuild("helm", "4.3.1", ("helm.sh/helm/v4/cmd/helm",), minutes=2)
    build.build(print)
    return build.programs()["helm"]

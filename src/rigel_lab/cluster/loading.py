"""Images of podman, docker or a tar file, put onto every node of a cluster."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rigel_k8s.errors import CommandFailed, LocalClusterError, UserError
from rigel_lab.cluster.commands import Report, run
from rigel_lab.cluster.requirements import require_root
from rigel_lab.cluster.state import State, find


def load(images: Sequence[str], name: str, *, report: Report = lambda _: None) -> None:
    """Put images of podman or docker, or of tar files, onto every node.

    Raises:
        UserError: the cluster, the file or the image does not exist.
        LocalClusterError: a node does not run.
        CommandFailed: a node refused the image.
    """
    require_root()
    state = find(name)
    for image in images:
        with archive(image) as path:
            for node in state.node_names:
                report(f"Loading {image} onto {node}")
                load_on_node(state, node, path)


def load_on_node(state: State, node: str, path: Path) -> None:
    """Import an archive into one node's containerd."""
    process = state.process(node)
    inside = process.children() if process else []
    if not inside:
        raise LocalClusterError(
            f"{node} of cluster {state.name} does not run",
            hint=f"rigel cluster up --name {state.name}",
        )
    socket = f"/proc/{inside[0].pid}/root{state.node_paths.socket}"
    ctr = state.components.program("ctr")
    run([ctr, "--address", socket, "--namespace", "k8s.io", "images", "import", str(path)])


@contextmanager
def archive(image: str) -> Iterator[Path]:
    """Give an image as a tar file: the named file itself, or what podman or docker saves.

    Raises:
        UserError: neither the file nor the image exists.
    """
    if Path(image).is_file():
        yield Path(image)
        return
    with tempfile.TemporaryDirectory(prefix="rigel-") as directory:
        path = Path(directory) / "image.tar"
        save(image, path)
        yield path


def save(image: str, path: Path) -> None:
    """Let the first engine that has an image write it to a file."""
    engines = list(engine_commands())
    reasons = []
    for engine in engines:
        try:
            run([*engine, "save", image], into=path)
            return
        except CommandFailed as error:
            reasons += [f"{' '.join(engine)}: {line}" for line in error.details[-1:]]
    if not engines:
        raise UserError(
            f"no file {image}, and neither podman nor docker is installed to save an image",
            hint="name a tar file that `docker save` or `podman save` wrote",
        )
    raise UserError(f"no file and no image {image}", details=reasons, hint="build or pull it first")


def engine_commands() -> Iterator[list[str]]:
    """Yield each engine's command; under sudo its user's own podman has its own images."""
    user = os.environ.get("SUDO_USER")
    if user and user != "root" and shutil.which("podman"):
        yield ["runuser", "-u", user, "--", "podman"]
    for program in ("podman", "docker"):
        if shutil.which(program):
            yield [program]

"""Copies results out of the application's pod, by tar through exec, like kubectl cp."""

from __future__ import annotations

import io
import tarfile
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, BinaryIO

from rigel_k8s.app.options import Results
from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.objects.facts import stays_ready
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

#: Seconds between two checks for results.
LOOK = 1.0


def copy_results(
    results: Results,
    release: ReleaseId,
    cluster: Cluster,
    target: Path,
    cancel: threading.Event,
) -> Path:
    """Copy source_path out of the newest ready pod into a directory; return what was written.

    Raises:
        RigelK8sError: no pod is ready, the path does not exist, or the image has no tar.
        Interrupted: the job was cancelled while it waited for the path.
    """
    pod = find_newest_pod(release, cluster)
    source = PurePosixPath(results.source_path)
    test = ["test", "-e", str(source)]

    def exists() -> bool:
        done = cluster.run(release.namespace, pod, test, container=str(results.container))
        return done.code == 0

    wait_until(exists, results, pod, cancel)
    place = (release.namespace, pod, str(results.container))
    copy_out(cluster, place, (source.parent, source.name or "."), target)
    return target / source.name


def copy_out(
    cluster: Cluster,
    place: tuple[str, str, str],
    source: tuple[PurePosixPath, str],
    target: Path,
) -> None:
    """Copy a file or a folder out of a container into a directory.

    Args:
        place: namespace, pod and container.
        source: its folder and its name there; "." is the folder's content.

    Raises:
        RigelK8sError: it does not exist, or the image has no tar.
    """
    namespace, pod, container = place
    folder, name = source
    with tempfile.TemporaryFile() as archive:
        errors = io.BytesIO()
        code = cluster.exec(
            namespace,
            pod,
            ["tar", "cf", "-", "-C", str(folder), name],
            container=container,
            stdin=None,
            stdout=archive,
            stderr=errors,
        )
        if code != 0:
            raise RigelK8sError(
                f"results: tar of {folder / name} in pod {pod} ended with exit code {code}",
                hint="install tar in the image",
                details=errors.getvalue().decode("utf-8", "replace").splitlines(),
            )
        archive.seek(0)
        extract(archive, target)


def find_newest_pod(release: ReleaseId, cluster: Cluster) -> str:
    """Return the name of the application's newest ready pod."""
    pods = [
        pod for pod in list_pods(cluster, release, {NAME_LABEL: release.name}) if stays_ready(pod)
    ]
    if not pods:
        raise RigelK8sError(
            f"results: no pod of {release.name} in {release.namespace} is ready",
            hint="see why with `rigel status`",
        )
    return str(max(pods, key=lambda p: p["metadata"]["creationTimestamp"])["metadata"]["name"])


def wait_until(
    exists: Callable[[], bool], results: Results, pod: str, cancel: threading.Event
) -> None:
    """Return when the path exists; check once if no wait was requested."""
    bound = results.wait.seconds if results.wait else 0.0
    deadline = time.monotonic() + bound
    while not exists():
        if time.monotonic() >= deadline:
            waited = f" after {bound:g} s" if bound else ""
            raise RigelK8sError(
                f"results: {results.source_path} does not exist in pod {pod}{waited}"
            )
        if cancel.wait(LOOK):
            raise Interrupted(f"stopped while waiting for {results.source_path} in pod {pod}")


def extract(archive: BinaryIO, target: Path) -> None:
    """Unpack an archive from a pod; refuse paths outside of the directory.

    Raises:
        RigelK8sError: a member points out of the directory, or the archive is cut off.
    """
    target.mkdir(parents=True, exist_ok=True)
    try:
        with tarfile.open(fileobj=archive) as opened:
            if hasattr(tarfile, "data_filter"):
                opened.extractall(target, filter="data")
            else:  # 3.10 before 3.10.12 and 3.11 before 3.11.4, such as Debian 12's
                opened.extractall(target, members=list(filter_members(opened)))
    except tarfile.TarError as error:
        raise RigelK8sError(f"results: cannot unpack the pod's archive: {error}") from error


def filter_members(archive: tarfile.TarFile) -> Iterator[tarfile.TarInfo]:
    """Yield files and directories of an archive, with rights that only their owner has to write.

    Raises:
        TarError: a member points out of the directory, or is a link or a device.
    """
    for member in archive:
        path = PurePosixPath(member.name)
        if path.is_absolute() or ".." in path.parts:
            raise tarfile.TarError(f"{member.name} is outside of the directory")
        if not (member.isfile() or member.isdir()):
            raise tarfile.TarError(f"{member.name} is neither a file nor a directory")
        member.mode &= 0o755
        yield member

"""What a test leaves of a release before that is deleted: the logs of its pods, and its bags."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from rigel_k8s.app.recording import NODE
from rigel_k8s.commands.bags import fetch
from rigel_k8s.commands.pods import find_matching, release_pods
from rigel_k8s.commands.targets import Release
from rigel_k8s.commands.testing.results import BAGS, LOGS
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.kube import Cluster
from rigel_k8s.release import development as restart
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings


def list_found(cluster: Cluster, namespace: str) -> list[Release]:
    return [Release(cluster, one.release) for one in list_releases(cluster, namespace)]


def collect(cluster: Cluster, settings: Settings, folder: Path, report: Reporter) -> None:
    """Save the logs of all pods of a namespace, and its bags; what fails is a warning."""
    try:
        for found in list_found(cluster, str(settings.namespace)):
            collect_release(found, settings, folder, report)
    except RigelK8sError as error:
        report.warn(f"not all logs and bags were saved: {error.message}")


def collect_release(found: Release, settings: Settings, folder: Path, report: Reporter) -> None:
    """Save the logs of a release's pods, and its bags; the one that is recorded is closed."""
    pods = release_pods(found)
    for pod in pods:
        save_log(found, pod.name, pod.container, folder / LOGS)
    if recorder := find_matching(pods, NODE):
        report.line(f"closing the bag of {found.id.name}")
        options = DeployOptions(report=report)
        restart.restart(found.cluster, found.id, [recorder[0].owner], options)
        fetch(settings, found.id.name, [], None, folder / BAGS, report)


def save_log(found: Release, pod: str, container: str, folder: Path) -> str:
    """Save what a container has printed, also before its last restart; return the former."""
    folder.mkdir(parents=True, exist_ok=True)
    text = ""
    for previous, ending in ((True, "previous.log"), (False, "log")):
        with suppress(ClusterError):  # it was not restarted, or has not begun
            lines = found.cluster.logs(found.id.namespace, pod, container, previous=previous)
            text = "".join(f"{line}\n" for line in lines)
            (folder / f"{pod}.{container}.{ending}").write_text(text, encoding="utf-8")
    return text

"""What a run leaves in its folder: how its tests ended, in the format of JUnit; logs and bags."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import attrs

from rigel_k8s.app.deploying.guests import State
from rigel_k8s.app.recording import NODE
from rigel_k8s.commands.bags import fetch
from rigel_k8s.commands.pods import find_matching, release_pods
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.kube import Cluster
from rigel_k8s.release import development as restart
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings

#: In the folder of a run.
RESULTS, LOGS, BAGS = "rigel.xml", "logs", "bags"
#: The name of the result of a run that failed before its tests had ended.
RUN = "run"
#: What XML has no place for.
CONTROL = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@attrs.frozen
class Result:
    """How one test ended.

    Attributes:
        suite: its release; of several runs, `RELEASE NUMBER`.
        message: why it has not passed.
        log: what it has printed.
    """

    suite: str
    name: str
    state: State
    seconds: float = 0.0
    message: str = ""
    log: str = attrs.field(default="", repr=False)


def name_folder(test: str) -> str:
    """Return what the folder of a test's files is called."""
    return test.strip("/").replace("/", "-")


def remove_results(folder: Path) -> None:
    """Remove what an earlier run, or several, have left in a folder, and nothing else."""
    path = folder / RESULTS
    if not path.exists():
        return
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError:
        root = ElementTree.Element("testsuites")
    cases, suites = (
        [one.attrib.get("name", "") for one in root.iter(tag)] for tag in ("testcase", "testsuite")
    )
    for number in {suite.partition(" ")[2] for suite in suites}:
        if number.isdigit():
            remove_results(folder / number)
            with suppress(OSError):
                (folder / number).rmdir()  # something else is in it, too
    tests = (name_folder(case) for case in cases if ":" not in case and "." not in case)
    for name in (LOGS, BAGS, *filter(None, tests)):
        shutil.rmtree(folder / name, ignore_errors=True)
    path.unlink()


def write_results(results: Sequence[Result], folder: Path) -> None:
    """Write results in the format of JUnit, which CI systems show."""
    root = ElementTree.Element("testsuites")
    for suite in dict.fromkeys(one.suite for one in results):
        own = [one for one in results if one.suite == suite]
        counts = {
            "failures": sum(one.state == "failed" for one in own),
            "skipped": sum(one.state == "unknown" for one in own),
        }
        attributes = {"name": suite, "tests": str(len(own))}
        group = ElementTree.SubElement(
            root, "testsuite", attributes | {key: str(count) for key, count in counts.items()}
        )
        for one in own:
            case = ElementTree.SubElement(
                group, "testcase", classname=suite, name=one.name, time=f"{one.seconds:.3f}"
            )
            if one.state != "passed":
                kind = "failure" if one.state == "failed" else "skipped"
                message = CONTROL.sub("?", one.message)
                ElementTree.SubElement(case, kind, message=message or "it was not measured")
            if one.log:
                ElementTree.SubElement(case, "system-out").text = CONTROL.sub("?", one.log)
    folder.mkdir(parents=True, exist_ok=True)
    ElementTree.ElementTree(root).write(folder / RESULTS, encoding="utf-8", xml_declaration=True)


def collect(cluster: Cluster, settings: Settings, folder: Path, report: Reporter) -> None:
    """Save the logs of all pods of a namespace, and its bags; what fails is a warning."""
    try:
        for one in list_releases(cluster, str(settings.namespace)):
            collect_release(Release(cluster, one.release), settings, folder, report)
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

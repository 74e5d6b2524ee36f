"""How tests ended, also in the format of JUnit; and what an earlier run has left in its folder."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from xml.etree import ElementTree

import attrs

from rigel_k8s.app.deploying.guests import State

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

"""What makes an entry of several lines, and its level; all collectors read these expressions."""

from __future__ import annotations

import json
import re

import pytest
import yaml

from rigel_k8s.commands.logs.lines import level_of
from rigel_k8s.observability import lines
from rigel_k8s.observability.names import LABELS, LEVELS

from .shapes import config, release

TRACEBACK = """\
[ERROR] [1700000000.1]: Traceback (most recent call last):
  File "node.py", line 3, in <module>
    rospy.spin()

During handling of the above exception, another exception occurred:
rospy.exceptions.ROSInterruptException: rospy shutdown
"""
LEVEL_OF = {
    "[INFO] [1700000000.123456]: hello": "info",
    "[INFO] [1700000000.123456, 12.5]: simulated": "info",
    "[ INFO] [1700000000.1]: rosconsole": "info",
    "\x1b[33m[ WARN] [1700000000.1]: coloured\x1b[0m": "warn",
    "\x1b[31m[FATAL] [1700000000.1]: lost\x1b[0m": "fatal",
    "[ERROR] [1700000000.123456789] [talker]: ROS 2": "error",
    "[DEBUG] [1700000000.123456789] [a.b.talker]: ROS 2": "debug",
    "[talker-1] [WARN] [1700000000.1] [talker]: launched": "warn",
    "[INFO] [talker-1]: process started with pid [7]": "info",
    "WARNING: no roscore": "warn",
    "2026-11-21T10:00:00.1Z  INFO main zenohd: started": "info",
    "2026-11-21 10:00:00.100 [RTPS_TRANSPORT_SHM Error] no port": "error",
    "[RTPS_PARTICIPANT Warning] late": "warn",
    "Traceback (most recent call last):": "error",
    "[INFO_1] is no level": "",
    "[information] neither": "",
    "it went into [ERROR] itself": "",
    "data: 'x'": "",
}
#: Read by the collectors only: programs that `rigel logs` shows without a level.
OWN = {
    "[rosmaster.main][INFO] 2026-11-21 10:00:00,1: started": "info",
    'ts=2026-11-21T10:00:00Z caller=a.go:1 level=warn msg="slow"': "warn",
    "level=info ts=2026-11-21T10:00:00Z msg=x": "info",
    "time=2026-11-21T10:00:00Z level=ERROR source=main.go msg=x": "error",
}


def collected(line: str) -> str:
    """Return the level that a collector gives a line, as its template does."""
    for form in lines.LEVEL_FORMS:
        if found := re.search(form, line):
            word = found["level"].lower()
            return lines.LEVEL_WORDS.get(word, word)
    return "error" if re.search(lines.TRACEBACK, line) else ""


@pytest.mark.parametrize("line", [*LEVEL_OF, *OWN])
def test_a_level_is_read_from_each_form(line: str) -> None:
    """ROS 1's, ROS 2's, their launches', and what runs beside them."""
    level = {**LEVEL_OF, **OWN}[line]
    assert collected(line) == level
    assert level in ("", *LEVELS)


@pytest.mark.parametrize("line", LEVEL_OF)
def test_rigel_logs_reads_the_same_level(line: str) -> None:
    """With a Loki or without one, `--level` shows the same lines."""
    assert level_of(line) == LEVEL_OF[line]


def test_what_goes_on_is_no_first_line() -> None:
    """Indented lines, empty ones, what stands between two exceptions, and the exception itself."""
    first, *rest = TRACEBACK.splitlines()
    assert begins(first)
    assert [line for line in rest if begins(line)] == []


@pytest.mark.parametrize(
    "line", ["Temperature: 3", "data: ValueError", "Errors: none", "ERROR: bad", "---", "x"]
)
def test_other_lines_begin_an_entry(line: str) -> None:
    """Plain output is not taken for the end of a traceback."""
    assert begins(line)


def begins(line: str) -> bool:
    """Whether a line begins an entry, once it is marked as the collector does."""
    marked = re.sub(lines.GOES_ON, lambda found: "\x01" + found[1], line)
    return bool(re.search(lines.FIRST_LINE, marked))


def test_the_labels_are_those_of_the_contract() -> None:
    """Each collector drops every other label that it makes itself, and Loki has the same list."""
    made = yaml.safe_load(config(release("{}"), "otel-collector", "collector.yaml"))
    statements = made["processors"]["transform/labels"]["log_statements"]
    names = json.dumps([*LABELS, "level"])
    assert f"keep_keys(resource.attributes, {names})" in statements
    loki = yaml.safe_load(config(release("{}"), "loki", "loki.yaml"))["limits_config"]
    (indexed,) = loki["otlp_config"]["resource_attributes"]["attributes_config"]
    assert indexed == {"action": "index_label", "attributes": [*LABELS, "level"]}
    made = yaml.safe_load(config(release("collector: promtail"), "promtail", "promtail.yaml"))
    (scrape,) = made["scrape_configs"]
    assert scrape["pipeline_stages"][-1] == {"labelallow": [*LABELS, "level"]}


def test_the_collector_reads_expressions_as_they_are() -> None:
    """It replaces `$NAME` and `${NAME}` in its configuration, except where a `$` is doubled."""
    text = config(release("{}"), "otel-collector", "collector.yaml")
    assert "$" in "".join((*lines.LEVEL_FORMS, lines.GOES_ON, lines.TRACEBACK))
    assert set(re.findall(r"(?<!\$)\$(?:\$\$)*(?!\$).{5}", text)) == {"${env:"}


def test_only_pods_of_releases_are_read_unless_all_are_asked_for() -> None:
    """Other people's pods are none of ours."""
    few, every = (
        config(release(f"{{collector: promtail, collect: {which}}}"), "promtail", "promtail.yaml")
        for which in ("releases", "all")
    )
    assert "selectors" in few
    assert "selectors" not in every
    few, every = (
        yaml.safe_load(config(release(f"{{collect: {which}}}"), "otel-collector", "collector.yaml"))
        for which in ("releases", "all")
    )
    assert "filter/releases" in few["service"]["pipelines"]["logs"]["processors"]
    assert "filter/releases" not in every["service"]["pipelines"]["logs"]["processors"]
    assert "labels" not in every["processors"]["k8s_attributes"]["filter"]

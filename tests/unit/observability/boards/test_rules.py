"""The rules: whole, explained, and doing what they promise when Prometheus evaluates them."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from rigel_k8s.cli.main import cli
from rigel_k8s.commands.top import NODES, TOPICS
from rigel_stack.boards import dashboards, rules

HERE = Path(__file__).parent
ROOT = HERE.parents[3]
PAGES = ROOT / "docs" / "runbooks"
CASES = HERE / "rules"
SOURCES = ROOT / "src"
#: Where the pages are to be published.
RUNBOOKS = "https://github.com/rigel-k8s/rigel-k8s/blob/main/docs/runbooks"


def run(*words: str) -> str:
    """Run a program; what it says belongs to the failure."""
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.programs
@pytest.mark.cluster  # promtool is built for one
def test_prometheus_takes_the_rules(promtool: str, tmp_path: Path) -> None:
    """Prometheus' own checker finds nothing wrong, and no two rules record one name twice."""
    for name, text in rules().items():
        (tmp_path / name).write_text(text)
    said = run(promtool, "check", "rules", *[str(tmp_path / name) for name in rules()])
    assert "FAILED" not in said
    assert "duplicate" not in said


@pytest.mark.programs
@pytest.mark.cluster  # promtool is built for one
@pytest.mark.parametrize("case", sorted(CASES.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_rule_does_what_its_cases_say(case: Path, promtool: str) -> None:
    """Each alert comes when it should, with these words, and not in a roll-out."""
    run(promtool, "test", "rules", str(case))


@pytest.mark.programs
@pytest.mark.cluster  # promtool is built for one
def test_top_shows_the_rate_whenever_the_exporter_has_looked(promtool: str, tmp_path: Path) -> None:
    """Between two scrapes, of which there is one each 15 s, it has looked once or twice."""
    looks = [scrape * 15 // 10 * 10 for scrape in range(41)]
    own = 'application="demo",namespace="lab"'
    labels = f'{own},instance="i",ros_node="/talker",topic="/chatter",direction="published"'
    series = {
        f"ros_node_topic_messages_total{{{labels}}}": [8 * look for look in looks],
        f'ros_exporter_last_collect_timestamp_seconds{{{own},instance="i"}}': looks,
    }
    expected = [
        {"expr": query.format(own), "eval_time": at, "exp_samples": [{"labels": who, "value": 8}]}
        for query, who in (
            (NODES["published"], '{ros_node="/talker"}'),
            (TOPICS["counted"], '{topic="/chatter"}'),
        )
        for at in ("30s", "45s", "4m", "10m")
    ]
    given = [
        {"series": name, "values": " ".join(map(str, found))} for name, found in series.items()
    ]
    case = {"interval": "15s", "input_series": given, "promql_expr_test": expected}
    (tmp_path / "case.yaml").write_text(yaml.safe_dump({"tests": [case]}))
    run(promtool, "test", "rules", str(tmp_path / "case.yaml"))


def test_each_alert_has_its_cases(alerts: dict[str, Any]) -> None:
    """An alert without a unit test is none."""
    assert {path.stem for path in CASES.glob("*.yaml")} - {"identity"} == set(alerts)


def test_each_alert_has_its_runbook_and_each_runbook_its_alert(alerts: dict[str, Any]) -> None:
    """Who is called at night finds a page, and no page tells of an alert that is gone."""
    assert {path.stem for path in PAGES.glob("*.md")} - {"README"} == set(alerts)


def test_alerts_say_what_is_wrong_and_where_to_look(alerts: dict[str, Any]) -> None:
    """Severity, a summary, a description, the runbook's address, and some patience."""
    for name, alert in alerts.items():
        assert alert["labels"]["severity"] in ("critical", "warning", "info"), name
        assert set(alert["annotations"]) == {"summary", "description", "runbook_url"}, name
        assert alert["annotations"]["runbook_url"] == f"{RUNBOOKS}/{name}.md"
        assert alert["for"] in ("1m", "2m", "5m", "10m"), name


def test_the_dashboard_s_alerts_lead_to_the_same_pages() -> None:
    """A click on an alert's name opens its runbook."""
    assert f"{RUNBOOKS}/${{__data.fields.Alert}}.md" in dashboards()["rigel-applications.json"]


@pytest.mark.parametrize(
    "heading", ["## What you see", "## What it means", "## Look", "## What to do"]
)
def test_runbooks_have_one_form(heading: str, alerts: dict[str, Any]) -> None:
    """Each page: symptom, meaning, commands to look with, what to do."""
    for name in alerts:
        text = (PAGES / f"{name}.md").read_text()
        assert text.startswith(f"# {name}\n"), name
        assert heading in text, name


def test_rules_ask_for_no_ros_metric_that_nobody_gives(alerts: dict[str, Any]) -> None:
    """A metric's name that the exporter does not have would be an alert that never comes."""
    given = "\n".join(path.read_text() for path in (SOURCES / "rigel_exporter").glob("*.py"))
    expressions = re.sub(r"#.*", "", "\n".join(rules().values()))
    asked = set(
        re.findall(
            r"(?<![:\w/-])ros_(?:node|topic|master|exporter|diagnostics)_\w+(?![:\w])", expressions
        )
    )
    assert len(asked) > 8
    assert {name for name in asked if f'"{name}"' not in given} == set()


def test_no_rule_uses_a_recorded_name_that_is_not_recorded(recorded: set[str]) -> None:
    """`level:metric:operations` in an expression is one of our own."""
    used = set(re.findall(r"\b[a-z_]+:[a-z_]+:[a-z0-9_]+\b", "\n".join(rules().values())))
    assert used == recorded


def test_runbooks_say_only_commands_that_there_are() -> None:
    """Each line with rigel in it is read by the command line: no option that is not there."""
    pages = "\n".join(page.read_text() for page in PAGES.glob("*.md"))
    said = re.findall(r"(?m)^rigel ([^#\n]*)", pages) + re.findall(r"`rigel ([^`]*)`", pages)
    assert len(said) > 15
    for line in said:
        words = line.split(" -- ")[0].split()
        result = CliRunner().invoke(cli, [*words, "--help"])
        assert result.exit_code == 0, f"rigel {line}: {result.output}"

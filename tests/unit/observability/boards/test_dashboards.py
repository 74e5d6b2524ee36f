"""The dashboards: what is described, in Grafana's form, complete and without a dead end."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import pytest

import rigel_stack.boards
from rigel_stack.boards import dashboards

FILES = Path(rigel_stack.boards.__file__).parent / "files"
BOARDS = {name: json.loads(text) for name, text in dashboards().items()}
EXPORTER = FILES.parents[2] / "rigel_exporter"
#: Variables of Grafana itself.
BUILT_IN = {
    "__auto",
    "__range",
    "__rate_interval",
    "__url_time_range",
    "__field",
    "__data",
    "__all",
}

each = pytest.mark.parametrize("model", BOARDS.values(), ids=BOARDS.keys())


def panels(model: dict[str, Any]) -> list[dict[str, Any]]:
    return [panel for panel in model["panels"] if panel["type"] != "row"]


def links(model: dict[str, Any]) -> Iterator[str]:
    """Yield the addresses of all links from a dashboard's panels."""
    for panel in panels(model):
        config = panel.get("fieldConfig", {"defaults": {}, "overrides": []})
        found = list(config["defaults"].get("links", []))
        for override in config["overrides"]:
            found += [x for p in override["properties"] if p["id"] == "links" for x in p["value"]]
        yield from (link["url"] for link in found)


def test_files_are_what_the_generator_writes(*, update_golden: bool) -> None:
    """The JSON that is deployed is made from the descriptions (--update-golden writes it)."""
    pytest.importorskip("grafana_foundation_sdk", reason="Grafana's builders want Python 3.11")
    from tools.boards import texts, write

    if update_golden:
        write()
    assert dashboards() == texts()


@each
def test_panels_have_ids_places_and_refs_of_their_own(model: dict[str, Any]) -> None:
    """No two panels have one id or lie on each other, none leaves the grid, refIds differ."""
    ids = [panel["id"] for panel in model["panels"]]
    assert len(set(ids)) == len(ids)
    for panel in panels(model):
        refs = [target["refId"] for target in panel["targets"]]
        assert len(set(refs)) == len(refs), panel["title"]
    for one, other in combinations([panel["gridPos"] for panel in model["panels"]], 2):
        assert one["x"] + one["w"] <= 24
        apart = (
            one["x"] + one["w"] <= other["x"]
            or other["x"] + other["w"] <= one["x"]
            or one["y"] + one["h"] <= other["y"]
            or other["y"] + other["h"] <= one["y"]
        )
        assert apart, (one, other)


@each
def test_sources_are_variables_that_begin_with_the_stack_s(model: dict[str, Any]) -> None:
    """No id of somebody's Grafana: every query asks a source that can be chosen."""
    chosen = {
        v["name"]: v["current"]["value"]
        for v in model["templating"]["list"]
        if v["type"] == "datasource"
    }
    assert chosen == {"metrics": "prometheus", "logs": "loki"}
    for panel in panels(model):
        for target in panel["targets"]:
            assert target["datasource"]["uid"] in ("${metrics}", "${logs}"), panel["title"]


@each
def test_every_variable_that_is_used_is_defined(model: dict[str, Any]) -> None:
    """A misspelt variable would be an empty panel."""
    text = json.dumps(model)
    used = set(re.findall(r"\$\{?(\w+)", text)) - BUILT_IN
    assert used <= {variable["name"] for variable in model["templating"]["list"]}


@each
def test_links_lead_to_dashboards_and_variables_that_are_there(model: dict[str, Any]) -> None:
    """A click never ends nowhere."""
    known = {
        board["uid"]: {v["name"] for v in board["templating"]["list"]} for board in BOARDS.values()
    }
    for url in links(model):
        if not url.startswith("/d/"):
            continue
        uid = url.removeprefix("/d/").split("?")[0]
        assert set(re.findall(r"&var-(\w+)=", url)) <= known[uid], url


def test_metrics_lead_to_logs_and_logs_to_metrics() -> None:
    """From a curve to its node's lines, and from who logs to its graph."""
    assert any(
        "/d/rigel-logs?" in url and "ros_node=" in url
        for url in links(BOARDS["rigel-applications.json"])
    )
    assert any(
        "/d/rigel-logs?" in url and "ros_node=" in url
        for url in links(BOARDS["rigel-ros-graph.json"])
    )
    assert any(
        "/d/rigel-ros-graph?" in url and "ros_node=" in url
        for url in links(BOARDS["rigel-logs.json"])
    )


@each
def test_every_panel_explains_itself(model: dict[str, Any]) -> None:
    """A title, what it shows, a unit for numbers, and words for an empty answer."""
    for panel in panels(model):
        assert panel["title"]
        assert panel["description"].endswith("."), panel["title"]
        if panel["type"] == "logs":
            continue
        assert panel["fieldConfig"]["defaults"]["noValue"], panel["title"]
        if panel["type"] in ("stat", "timeseries"):
            assert panel["fieldConfig"]["defaults"]["unit"], panel["title"]


def test_roll_outs_are_marked_where_applications_are_shown() -> None:
    """A curve that bends where something was deployed shows it."""
    marked = {name for name, model in BOARDS.items() if model["annotations"]["list"]}
    assert marked == set(BOARDS) - {"rigel-machines.json"}


def test_dashboards_ask_for_what_is_recorded_and_exported(recorded: set[str]) -> None:
    """No panel asks for a name that neither our rules record nor our exporter gives."""
    expressions = "\n".join(
        target["expr"]
        for model in BOARDS.values()
        for panel in panels(model)
        for target in panel["targets"]
    )
    ours = set(re.findall(r"\b[a-z_]+:[a-z_]+:[a-z0-9_]+\b", expressions))
    assert ours
    assert ours <= recorded
    given = "\n".join(path.read_text() for path in EXPORTER.glob("*.py"))
    asked = set(re.findall(r"(?<![:\w$.])ros_\w+(?=\{)", expressions))
    assert len(asked) > 12
    assert {name for name in asked if f'"{name}"' not in given} == set()


def test_uids_never_change() -> None:
    """People's bookmarks and our own links name them."""
    assert {model["uid"] for model in BOARDS.values()} == {
        "rigel-applications",
        "rigel-ros-graph",
        "rigel-logs",
        "rigel-machines",
    }


@pytest.mark.programs
@pytest.mark.cluster  # promtool is built for one
@each
def test_prometheus_can_read_every_query(
    model: dict[str, Any], promtool: str, tmp_path: Path
) -> None:
    """Also the queries of marks: with durations in their places, Prometheus' checker takes them."""
    targets = [target for panel in panels(model) for target in panel["targets"]]
    asked = [t["expr"] for t in targets if t["datasource"]["type"] == "prometheus"]
    asked += [mark["expr"] for mark in model["annotations"]["list"]]
    filled = [re.sub(r"\[\$\w+\]", "[1m]", expr) for expr in asked]
    rules = [{"record": f"query:{number}", "expr": expr} for number, expr in enumerate(filled)]
    file = tmp_path / "queries.yaml"
    file.write_text(json.dumps({"groups": [{"name": "queries", "rules": rules}]}))
    done = subprocess.run([promtool, "check", "rules", str(file)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_machine_s_traffic_is_nobody_s_pod() -> None:
    """A pod on the machine's network would be shown with all that the machine sends."""
    targets = [t for m in BOARDS.values() for panel in panels(m) for t in panel["targets"]]
    counted = [t["expr"] for t in targets if "container_network_" in t["expr"]]
    assert len(counted) == 4
    assert all(
        'unless on (namespace, pod) kube_pod_info{host_network="true"}' in e for e in counted
    )

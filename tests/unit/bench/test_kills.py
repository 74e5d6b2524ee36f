"""Each write that `python -m bench.kills` kills a command at has its row in the documentation."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bench.kills.killing import describe
from bench.kills.scenarios import SCENARIOS, Scenario, clear, run_again, take_snapshot
from bench.kills.table import Kill, draw, read_steps
from rigel_k8s.release.lease import lease_ref
from rigel_k8s.release.types import ReleaseId
from tests.support.fake_cluster import FakeCluster

DOCUMENT = Path(__file__).parents[3] / "docs" / "reliability-tests.md"
IN_MEMORY = [scenario for scenario in SCENARIOS if scenario.name != "observability stack"]


def list_steps(fake: FakeCluster) -> set[str]:
    """Return the writes so far by the names that a table has for them."""
    return {describe(f"{verb} {ref}", "n") for verb, ref in fake.writes}


@pytest.mark.parametrize("scenario", IN_MEMORY, ids=lambda scenario: scenario.name)
def test_the_table_has_the_writes_of_each_command(scenario: Scenario, fake: FakeCluster) -> None:
    """Neither more nor less: a new write is one that was never killed."""
    scenario.before(fake, "n")
    fake.calls.clear()
    scenario.command(fake, "n")
    assert read_steps(DOCUMENT.read_text())[scenario.name] == list_steps(fake)


def test_no_cell_of_the_table_is_wrong_or_empty() -> None:
    rows = re.findall(r"^\| .* \| \d+ \|$", DOCUMENT.read_text(), re.MULTILINE)
    assert rows
    for row in rows:
        assert "WRONG" not in row
        assert " - " not in row


@pytest.mark.parametrize("scenario", IN_MEMORY, ids=lambda scenario: scenario.name)
def test_the_harness_sees_what_a_command_leaves_undone(
    scenario: Scenario, fake: FakeCluster
) -> None:
    """A command that did nothing is not called complete."""
    scenario.before(fake, "n")
    untouched = take_snapshot(fake, scenario, "n")
    scenario.command(fake, "n")
    wanted = take_snapshot(fake, scenario, "n")
    assert wanted.is_as(wanted)
    assert not untouched.is_as(wanted)
    fake.create(lease_like(scenario))
    assert not take_snapshot(fake, scenario, "n").is_as(wanted)
    fake.delete(lease_ref(ReleaseId("n", scenario.release)))
    clear(fake, scenario, "n")
    idle = Scenario(scenario.name, scenario.release, scenario.before, scenario.before)
    scenario.before(fake, "n")
    if scenario.name != "first deploy":
        assert run_again(idle, fake, "n", wanted).startswith("WRONG")


def lease_like(scenario: Scenario) -> dict[str, object]:
    """Return a Lease that a killed process could have left."""
    ref = lease_ref(ReleaseId("n", scenario.release))
    meta = {"name": ref.name, "namespace": "n"}
    return {"apiVersion": ref.api_version, "kind": ref.kind, "metadata": meta, "spec": {}}


def test_a_table_has_a_row_for_each_write() -> None:
    kills = [
        Kill("down", "delete Lease rigel.demo", "before", "completed"),
        Kill("down", "delete Lease rigel.demo", "after", "was complete"),
    ]
    drawn = "\n".join(draw(kills))
    assert drawn.splitlines()[2:] == [
        "| down | delete Lease rigel.demo | completed | - | was complete | 2 |"
    ]
    assert read_steps(drawn) == {"down": {"delete Lease rigel.demo"}}

"""What `python -m bench.kills` compares sees what a killed command left undone."""

from __future__ import annotations

import pytest

from bench.kills.scenarios import SCENARIOS, Scenario, clear, run_again, take_snapshot
from rigel_k8s.release.locking import lease_ref
from rigel_k8s.release.types import ReleaseId
from tests.support.fake_cluster import FakeCluster

IN_MEMORY = [scenario for scenario in SCENARIOS if scenario.name != "observability stack"]


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

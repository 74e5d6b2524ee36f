"""Kills at writes that once went wrong, on a real API server; `python -m bench.kills` has all."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from bench.kills.__main__ import kill_once, run_undisturbed
from bench.kills.killing import Moment, in_child
from bench.kills.scenarios import SCENARIOS, delete_namespace

pytestmark = pytest.mark.cluster

#: A command, the number of the write at which it is killed, and when.
SAMPLE: list[tuple[str, int, Moment]] = [
    ("first deploy", 7, "after"),  # good, and the Lease is left
    ("rollback", 2, "after"),  # pending: its target is not the last good revision
    ("rollback", 8, "sent"),  # perhaps good
    ("down --volumes", 7, "after"),  # only the Lease is left
]


@pytest.fixture(scope="module")
def own_namespace(context: str) -> Iterator[str]:
    """A namespace that no process of this one has a connection for."""
    yield "t-kills"
    in_child(context, lambda cluster: delete_namespace(cluster, "t-kills"))


@pytest.mark.parametrize(("name", "limit", "moment"), SAMPLE)
def test_the_same_command_again_completes_the_work(
    context: str, own_namespace: str, name: str, limit: int, moment: Moment
) -> None:
    [scenario] = [one for one in SCENARIOS if one.name == name]
    wanted = run_undisturbed(context, scenario, own_namespace)
    kill = kill_once(context, scenario, own_namespace, wanted, limit, moment)
    assert kill is not None
    assert kill.result in ("completed", "was complete"), kill

"""A second Rigelfile with the default name never deletes the first robot without a word."""

from __future__ import annotations

from typing import Any

import attrs
import pytest

from rigel_k8s.release import revisions
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.types import Desired
from tests.support.manifests import RELEASE, claim, workload
from tests.support.releases import deploy, diff, rollback

HERE, THERE = "/home/ann/robot", "/home/ann/second"


def from_folder(source: str, *names: str, master: bool = False) -> Desired:
    """Return what a Rigelfile in a folder describes."""
    first = [workload("ros-master", first=True)] if master else []
    return Desired(RELEASE, (*first, *map(workload, names)), source=source)


@pytest.fixture
def robot(fake: Any, report: Any) -> Any:
    """A robot, deployed from a folder."""
    deploy(from_folder(HERE, "driver", "filter", master=True), fake, report=report)
    return fake


def test_another_folder_with_other_nodes_is_refused(robot: Any, report: Any) -> None:
    """With what would be deleted, and both ways out; `diff` says the same."""
    wanted, before = from_folder(THERE, "imu", master=True), list(robot.writes)
    for use in (lambda: deploy(wanted, robot, report=report), lambda: diff(wanted, robot)):
        with pytest.raises(Refused) as caught:
            use()
        [problem] = caught.value.problems
        assert "was deployed from /home/ann/robot" in problem.message
        assert "driver, filter would be deleted" in problem.message
        assert problem.path == ("deployment_name",)
    assert robot.writes == before


@pytest.mark.parametrize(
    "wanted",
    [
        from_folder(HERE, "imu", master=True),
        from_folder("", "imu"),
        from_folder(THERE, master=True),
    ],
    ids=["same folder", "unknown folder", "no node"],
)
def test_other_changes_are_none_of_that(robot: Any, report: Any, wanted: Desired) -> None:
    """What is deleted is named."""
    deploy(wanted, robot, report=report)
    [line] = [text for text in (*report.lines, *report.warnings) if "deleted" in text]
    assert line.startswith("no longer in the Rigelfile, and deleted: ")
    assert "filter" in line


def test_a_robot_of_another_folder_that_shares_some_names_is_refused(fake: Any, report: Any):
    """A `driver` is in many robots; a copy of the folder without one node is this robot."""
    deploy(from_folder(HERE, "driver", "filter", "planner"), fake, report=report)
    with pytest.raises(Refused) as caught:
        deploy(from_folder(THERE, "driver", "imu"), fake, report=report)
    assert "filter, planner would be deleted" in caught.value.problems[0].message
    deploy(from_folder(THERE, "driver", "filter"), fake, report=report)
    assert "and deleted: planner (deployed from /home/ann/robot before)" in str(report.warnings)


def test_a_folder_that_depends_on_where_it_was_said_is_not_known(fake: Any, report: Any) -> None:
    """As earlier versions recorded it."""
    deploy(from_folder(".", "driver", "filter"), fake, report=report)
    deploy(from_folder(THERE, "imu"), fake, report=report)
    assert "driver" in str([line for line in report.lines if "deleted" in line])


def test_it_can_be_replaced(robot: Any, report: Any) -> None:
    """And the rollback belongs to the first folder again."""
    deploy(from_folder(THERE, "imu"), robot, report=report, adopt=True)
    rollback(robot, RELEASE, report=report)
    sources = [record.revision().source for record in revisions.records(robot, RELEASE)]
    assert sources == [HERE, THERE, HERE]


def test_a_rollback_names_its_revision(robot: Any, report: Any) -> None:
    """The Rigelfile may have what the revision does not."""
    wanted = from_folder(HERE, "driver", "filter", "imu", master=True)
    wanted = attrs.evolve(wanted, objects=(*wanted.objects, claim("bags")))
    deploy(wanted, robot, report=report)
    rollback(robot, RELEASE, report=report)
    assert "not in revision 1, and deleted: imu" in report.lines
    assert "bags is not in revision 1; it holds data, so it is kept" in str(report.warnings)
    assert "Rigelfile" not in str(report.lines + report.warnings)

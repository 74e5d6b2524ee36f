"""Which workloads have no machine of the kind that their images run on."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.app.deploying.architectures import explain, find_unfit_machines
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release.types import Desired
from tests.support.manifests import RELEASE, config, workload
from tests.support.releases import deploy

IMAGE = "r/app:1@sha256:a"


def node(architecture: str | None, **labels: str) -> dict[str, Any]:
    known = {"kubernetes.io/arch": architecture} if architecture else {}
    return {"metadata": {"labels": {**known, **labels}}}


def pinned(**selector: str) -> dict[str, Any]:
    made = workload(image=IMAGE)
    made["spec"]["template"]["spec"]["nodeSelector"] = selector
    return made


@pytest.mark.parametrize(
    ("selector", "nodes", "runs_on", "refused"),
    [
        ({}, [node("amd64")], {"amd64"}, False),
        ({}, [node("amd64")], {"arm64"}, True),
        ({}, [node("amd64"), node("arm64")], {"arm64"}, False),
        ({"robot": "r1"}, [node("amd64"), node("arm64", robot="r1")], {"amd64"}, True),
        ({"robot": "r1"}, [node("amd64")], {"arm64"}, False),  # check_places reports that
        ({}, [node("amd64"), node(None)], {"arm64"}, False),
        ({}, [node("amd64")], set(), False),
        ({}, [], {"arm64"}, False),
    ],
)
def test_only_what_no_chosen_machine_runs_is_refused(
    selector: dict[str, str], nodes: list[Any], runs_on: set[str], *, refused: bool
) -> None:
    """What a machine or a registry does not say is no refusal."""
    found = dict(explain([pinned(**selector)], nodes, {IMAGE: frozenset(runs_on)}))
    assert bool(found) is refused


def test_machines_that_we_may_not_see_refuse_nothing(fake: Any) -> None:
    """Most who may deploy into a namespace may not list nodes."""

    class Blind(type(fake)):  # type: ignore[misc]
        def nodes(self) -> Any:
            raise ClusterError("you may not")

    assert find_unfit_machines([pinned()], Blind(fake.store), ()) == {}


def test_the_reason_names_both_sides() -> None:
    """The image as the user writes it."""
    [(ref, text)] = explain([pinned()], [node("amd64")], {IMAGE: frozenset({"arm64"})})
    assert ref.name == "talker"
    assert text == "r/app:1 runs on arm64, but the cluster's machines are amd64"


def test_a_deploy_asks_for_changed_workloads_alone_and_refuses(fake: Any, report: Any) -> None:
    """Before the first write, and never for a release that stays as it is."""
    asked: list[list[str]] = []

    def inspect(workloads: Any) -> dict[Any, str]:
        asked.append([one["metadata"]["name"] for one in workloads])
        return {}

    deploy(Desired(RELEASE, (workload(),), inspect=inspect), fake, report=report)
    deploy(Desired(RELEASE, (workload(),), inspect=inspect), fake, report=report)
    deploy(Desired(RELEASE, (workload(), config()), inspect=inspect), fake, report=report)
    assert asked == [["talker"]]
    newer = workload(image="app:2")
    fake.calls.clear()
    way_out = {"architecture": "build it"}
    wanted = Desired(RELEASE, (newer,), remedies=way_out, inspect=refuse_all)
    with pytest.raises(UserError) as caught:
        deploy(wanted, fake, report=report)
    assert caught.value.details == ("Deployment n/talker: no machine; build it",)
    assert fake.writes == []


def test_what_a_release_does_not_need_is_a_warning(fake: Any, report: Any) -> None:
    """An exporter for another processor stops no robot; it is said before the wait for it."""
    marks = {OPTIONAL_ANNOTATION: "true", REMEDY_ANNOTATION: "push another image"}
    wanted = Desired(RELEASE, (workload(**marks),), inspect=refuse_all)
    assert deploy(wanted, fake, report=report).status == "good"
    [told] = report.warnings
    assert told.startswith("talker will not start: no machine; ")
    assert told.endswith("runs without it; push another image")


def refuse_all(workloads: Any) -> dict[Any, str]:
    return {ref_of(one): "no machine" for one in workloads}

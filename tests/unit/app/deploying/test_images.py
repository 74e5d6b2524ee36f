"""Which workloads have no machine of the kind that their images run on."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.app.deploying.images import Images, find_absent, find_unfit
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release.types import Desired, Obstacle
from tests.support.manifests import RELEASE, config, workload
from tests.support.releases import deploy

IMAGE = "r/app:1@sha256:a"


def node(architecture: str | None, **labels: str) -> dict[str, Any]:
    known = {"kubernetes.io/arch": architecture} if architecture else {}
    return {"metadata": {"name": "x", "labels": {**known, **labels}}}


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
        ({"robot": "r1"}, [node("amd64")], {"arm64"}, False),  # `find_homeless` reports that
        ({}, [node("amd64"), node(None)], {"arm64"}, False),
        ({}, [node("amd64")], set(), False),
        ({}, [], {"arm64"}, False),
    ],
)
def test_only_what_no_chosen_machine_runs_is_refused(
    selector: dict[str, str], nodes: list[Any], runs_on: set[str], *, refused: bool
) -> None:
    """What a machine or a registry does not say is no refusal."""
    found = list(find_unfit([pinned(**selector)], nodes, {IMAGE: frozenset(runs_on)}))
    assert bool(found) is refused


def test_machines_that_we_may_not_see_refuse_nothing(fake: Any, report: Any) -> None:
    """Most who may deploy into a namespace may not list nodes."""

    class Blind(type(fake)):  # type: ignore[misc]
        def nodes(self) -> Any:
            raise ClusterError("you may not")

    wanted = Desired(RELEASE, (pinned(),), inspect=Images(fake).find_obstacles)
    assert deploy(wanted, Blind(fake.store), report=report).status == "good"


def test_the_reason_names_both_sides() -> None:
    """The image as the user writes it."""
    [found] = find_unfit([pinned()], [node("amd64")], {IMAGE: frozenset({"arm64"})})
    assert found.ref.name == "talker"
    assert found.text == "r/app:1 runs on arm64, but the cluster's machines are amd64"


def test_a_deploy_asks_for_changed_workloads_alone_and_refuses(fake: Any, report: Any) -> None:
    """Before the first write, and never for a release that stays as it is."""
    asked: list[list[str]] = []

    def inspect(workloads: Any, nodes: Any) -> list[Obstacle]:
        asked.append([one["metadata"]["name"] for one in workloads])
        return []

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


def refuse_all(workloads: Any, nodes: Any) -> list[Obstacle]:
    return [Obstacle(ref_of(one), "no machine", "architecture") for one in workloads]


TAGGED = "r.lab/app:1"


@pytest.mark.parametrize(
    ("policy", "reported", "refused"),
    [
        (None, [["r.lab/other:1"]], True),
        (None, [["r.lab/other:1"], [TAGGED]], False),  # loaded onto a machine
        ("Always", [[TAGGED]], True),
        ("Never", [[]], False),
        (None, [[f"r.lab/{number}:1" for number in range(50)]], False),  # it may have more
        (None, [], False),  # machines that we may not see
    ],
)
def test_an_image_that_exists_nowhere_is_refused(
    policy: str | None, reported: list[list[str]], *, refused: bool
) -> None:
    """Its registry does not have it, and no machine does."""
    nodes = [{"status": {"images": [{"names": [name]} for name in own]}} for own in reported]
    made = workload(image=TAGGED)
    if policy:
        made["spec"]["template"]["spec"]["containers"][0]["imagePullPolicy"] = policy
    found = [one.text for one in find_absent([made], nodes, frozenset({TAGGED}))]
    assert found == (["the registry r.lab does not have the image r.lab/app:1"] if refused else [])
    assert list(find_absent([made], nodes, frozenset())) == []

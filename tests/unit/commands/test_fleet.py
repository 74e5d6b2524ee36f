"""`rigel down --sequence`: which releases end, in which order, and what is reported."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.commands import fleet, releases
from rigel_k8s.errors import ClusterError, Interrupted, ProblemsError, UserError
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder
from tests.support.releases import deploy

RIGELFILE = """
application: {distro: noetic}
jobs:
  base:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {namespace: base, deployment_name: base, nodes: {a: {image: "a:1"}}}
  robot:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {namespace: "{{ data.robot }}", deployment_name: app, nodes: {a: {image: "a:1"}}}
  stack:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {observability_only: true, observability: {enabled: true}}
  build:
    plugin: rigel_k8s.BuildXPlugin
    with: {image: a}
  foreign:
    plugin: somebody.elses.Plugin
sequences:
  fleet:
    stages:
      - jobs: [build, foreign, stack, base]
      - parallel:
          - jobs: [robot, {name: robot, with: {deployment_name: other}}]
        matrix: {robot: [r1, r2], max_parallel: [1]}
  late:
    stages: [{jobs: [robot]}]
"""
ROBOTS = [ReleaseId(robot, name) for robot in ("r1", "r2") for name in ("app", "other")]
BASE = ReleaseId("base", "base")


class SharedCluster(FakeCluster):
    """A cluster that several commands connect to."""

    namespace = "n"

    def __enter__(self) -> SharedCluster:
        return self

    def __exit__(self, *_: object) -> None:
        pass


@pytest.fixture
def cluster(fake: FakeCluster, monkeypatch: pytest.MonkeyPatch) -> SharedCluster:
    shared = SharedCluster(fake.store)
    monkeypatch.setattr(fleet, "connect", lambda _: shared)
    return shared


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    (tmp_path / "Rigelfile").write_text(RIGELFILE)
    return Settings(tmp_path / "Rigelfile")


def put(cluster: Any, *found: ReleaseId) -> None:
    """Deploy releases with one ConfigMap each."""
    for release in found:
        space: Manifest = {
            "apiVersion": "v1",
            "kind": "Namespace",
            "metadata": {"name": release.namespace},
        }
        if not any(o.name == release.namespace for o in cluster.objects):
            cluster.create(space)
        meta = {"name": release.name, "namespace": release.namespace}
        config = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": meta, "data": {}}
        deploy(Desired(release, (config,)), cluster, report=Recorder())


def left(cluster: Any) -> set[str]:
    return {ref.name for ref in cluster.objects if ref.kind == "ConfigMap"}


def test_all_releases_of_a_sequence_end(cluster: Any, settings: Settings, report: Recorder) -> None:
    """Each combination of the matrix, with what the sequence lays over a job; no other release."""
    bystander = ReleaseId("r1", "bystander")
    put(cluster, BASE, *ROBOTS, bystander)
    removed = fleet.down(settings, "fleet", report, volumes=False)
    assert {release for release, _ in removed} == {BASE, *ROBOTS}
    assert left(cluster) == {"bystander"}


def test_the_last_stage_ends_first(cluster: Any, settings: Settings, report: Recorder) -> None:
    put(cluster, BASE, *ROBOTS)
    cluster.store.calls.clear()
    fleet.down(settings, "fleet", report, volumes=False)
    ended = [
        call[1].name
        for call in cluster.store.calls
        if call[0] == "delete" and call[1].kind == "ConfigMap"
    ]
    assert len(ended) == 5
    assert ended[-1] == "base"


def test_what_does_not_exist_is_no_error_beside_the_rest(
    cluster: Any, settings: Settings, report: Recorder
) -> None:
    put(cluster, ROBOTS[0])
    removed = dict(fleet.down(settings, "fleet", report, volumes=False))
    assert [release for release, plan in removed.items() if not plan.is_empty] == [ROBOTS[0]]
    with pytest.raises(UserError, match='no release of the sequence "fleet" exists'):
        fleet.down(settings, "fleet", report, volumes=False)


def test_a_failure_stops_no_other_robot_but_the_stages_before(
    cluster: Any, settings: Settings, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a robot that is left may need is left, too; all is listed."""
    put(cluster, BASE, *ROBOTS)
    down = releases.down

    def fail_once(found: Any, *args: Any, **kwargs: Any) -> Any:
        if found.id == ROBOTS[0]:
            raise ClusterError("the pod hangs", hint="look at it")
        return down(found, *args, **kwargs)

    monkeypatch.setattr(releases, "down", fail_once)
    with pytest.raises(ClusterError, match="1 of 5 releases could not be deleted") as caught:
        fleet.down(settings, "fleet", report, volumes=False)
    assert caught.value.details == (
        "done: other in r1; app in r2; other in r2",
        "not begun: base in base",
        "failed: app in r1: the pod hangs",
        "  hint: look at it",
    )
    assert left(cluster) == {"app", "base"}


def test_ctrl_c_begins_no_further_release(
    cluster: Any, settings: Settings, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(cluster, BASE, *ROBOTS)

    def interrupt(_: Any, __: Any, ___: Any, cancel: threading.Event, **____: Any) -> None:
        cancel.set()
        raise Interrupted("stopped")

    monkeypatch.setattr(releases, "down", interrupt)
    monkeypatch.setattr(fleet, "WIDTH", 1)
    with pytest.raises(Interrupted, match="before all releases were deleted") as caught:
        fleet.down(settings, "fleet", report, volumes=False)
    assert caught.value.details == (
        "stopped: app in r1",
        "not begun: other in r1; app in r2; other in r2; base in base",
    )


def test_a_namespace_of_the_command_line_replaces_that_of_the_jobs(
    cluster: Any, settings: Settings, report: Recorder
) -> None:
    put(cluster, ReleaseId("lab", "app"), *ROBOTS)
    words = attrs.evolve(settings, namespace="lab")
    removed = dict(fleet.down(words, "fleet", report, volumes=False))
    assert not removed[ReleaseId("lab", "app")].is_empty
    assert {"app", "other"} <= left(cluster)


def test_a_name_that_a_job_would_store_is_refused(
    cluster: Any, settings: Settings, report: Recorder
) -> None:
    """With its place and the way out."""
    with pytest.raises(ProblemsError) as caught:
        fleet.down(settings, "late", report, volumes=False)
    assert "no earlier job has stored data.robot" in caught.value.details[0]
    assert "-n" in str(caught.value.hint)


def test_an_unknown_sequence_is_named(cluster: Any, settings: Settings, report: Recorder) -> None:
    with pytest.raises(UserError, match='unknown sequence "flet", did you mean "fleet"'):
        fleet.down(settings, "flet", report, volumes=False)

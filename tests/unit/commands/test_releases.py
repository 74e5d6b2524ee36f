"""What the commands on a release pass on, and what they make of the answers."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from rigel_graph.commands.live import Live
from rigel_graph.types import RosGraph
from rigel_k8s.commands import pods, releases, top
from rigel_k8s.commands import status as reading
from rigel_k8s.commands.dev import session
from rigel_k8s.commands.join.session import find_deployment
from rigel_k8s.commands.logs import reading as logs
from rigel_k8s.commands.logs.lines import LogOptions
from rigel_k8s.commands.status import Status
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.release import apply
from rigel_k8s.release.status import ReleaseStatus, WorkloadStatus, status
from rigel_k8s.release.types import Desired
from rigel_k8s.settings import Settings
from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, claim, config, desired, ref, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy


@pytest.fixture(autouse=True)
def release(fake: FakeCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    """The release that every command finds."""

    def found(settings: Settings, job: str | None = None, nodes: Any = (), **_: Any) -> Release:
        return Release(fake, RELEASE)  # type: ignore[arg-type]

    for module in (releases, reading, logs, pods, top, session):
        monkeypatch.setattr(module, "release", found)


def found(fake: Any) -> Release:
    return Release(fake, RELEASE)


def test_down_leaves_volumes_unless_they_are_asked_for(fake: Any, report: Recorder) -> None:
    deploy(desired(config(), claim()), fake, report=report)
    plan = releases.down(found(fake), Settings(), report, volumes=False)
    assert sorted((step.action, step.ref.name) for step in plan.steps) == [
        ("forget", "data"),
        ("prune", "c"),
    ]
    assert fake.names("PersistentVolumeClaim") == {"data"}
    releases.down(found(fake), Settings(), report, volumes=True)
    assert fake.names("PersistentVolumeClaim") == set()


def test_down_waits_as_long_as_it_may(
    fake: Any, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apply, "SLICE", 0.05)
    deploy(desired(workload()), fake, report=report)
    fake.store.controllers = Controllers(ending={"talker": 10**9})
    with pytest.raises(ClusterError, match=r"did not end within 0\.1 s"):
        releases.down(found(fake), Settings(timeout=0.1), report, volumes=False)


def test_status_is_well_when_all_is_ready(fake: Any, report: Recorder) -> None:
    deploy(desired(workload(), workload("listener")), fake, report=report)
    assert reading.status(Settings(), None, graph=False).ok


def test_one_workload_is_enough() -> None:
    good = WorkloadStatus("Deployment", "a", 1, 1, True, "", ())
    bad = WorkloadStatus("Deployment", "b", 0, 1, False, "", ())
    assert Status(ReleaseStatus(RELEASE, 1, "good", (good, good))).ok
    assert not Status(ReleaseStatus(RELEASE, 1, "good", (good, bad))).ok


def test_status_of_nothing_is_told(fake: Any) -> None:
    with pytest.raises(UserError, match="there is no release demo"):
        status(fake, RELEASE)


def test_a_rollback_passes_its_words_on(fake: Any, report: Recorder) -> None:
    """The revision's number, the time, and who may be overwritten."""
    for number in (1, 2, 3):
        deploy(desired(config(k=str(number))), fake, report=report)
    assert releases.rollback(found(fake), Settings(), 1, report).number == 4
    assert fake.list("v1", "ConfigMap", "n")[0]["data"] == {"k": "1"}
    fake.as_manager("kubectl").patch(
        next(r for r in fake.objects if r.name == "c"), {"data": {"k": "9"}}
    )
    with pytest.raises(ClusterError, match="managed by others"):
        releases.rollback(found(fake), Settings(), 2, report)
    releases.rollback(found(fake), Settings(adopt=True), 2, report)
    assert fake.list("v1", "ConfigMap", "n")[0]["data"] == {"k": "2"}


@pytest.mark.parametrize(
    "command",
    [
        lambda _, node: list(logs.logs(Settings(), [node], LogOptions())),
        lambda _, node: top.top(Settings(), [node]),
        lambda _, node: list(pods.forward(Settings(), node, {})),
        lambda _, node: pods.execute(
            Settings(), node, [], stdin=None, stdout=BytesIO(), stderr=BytesIO(), tty=False
        ),
        lambda own, node: releases.restart(own, Settings(), [node], Recorder()),
        lambda _, node: session.develop(Settings(), node, [], [], Recorder(), print),
        find_deployment,
        lambda own, node: Live(own, pods.release_pods(own), RosGraph(), "1").find_node(node),
    ],
    ids=["logs", "top", "forward", "exec", "restart", "dev", "join", "param"],
)
def test_a_misspelt_node_leads_to_the_right_one(
    command: Callable[[Release, str], object], fake: Any, report: Recorder
) -> None:
    """In every command that has a node's name."""
    deploy(desired(workload("driver")), fake, report=report)
    with pytest.raises(
        UserError, match='no pod of a node "drivr", did you mean "driver"'
    ) as caught:
        command(found(fake), "drivr")
    assert caught.value.hint == "its nodes are: driver"


def test_one_log_that_is_not_there_is_no_end(
    fake: Any, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of several pods the others are shown; of one alone it is the error."""
    deploy(desired(workload("broken"), workload("talker")), fake, report=report)

    def read(self: Any, namespace: str, pod: str, *_: Any, **__: Any) -> Iterator[str]:
        if "broken" in pod:
            raise ClusterError("no log yet")
        return iter(["2026-01-01T00:00:01Z hello"])

    monkeypatch.setattr(FakeCluster, "logs", read)
    found = list(logs.logs(Settings(), [], LogOptions()))
    assert [(line.text, line.note) for line in found] == [("no log yet", True), ("hello", False)]
    with pytest.raises(ClusterError, match="no log yet"):
        list(logs.logs(Settings(), ["broken"], LogOptions()))


def test_a_pod_that_comes_later_is_followed_from_its_beginning(
    fake: Any, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `--tail` leaves out is what was said before we looked."""
    deploy(desired(workload()), fake, report=report)
    reads: list[int | None] = []

    def read(self: Any, *_: Any, follow: bool, tail: int | None = None, **__: Any) -> Iterator[str]:
        reads.append(tail)
        early = [] if tail else ["2026-01-01T00:00:01.5Z early"]
        return iter([*early, "2026-01-01T00:00:02Z hello"])

    monkeypatch.setattr(FakeCluster, "logs", read)
    following = logs.logs(Settings(), [], LogOptions(follow=True, tail=1))
    first = next(following)
    assert first.text == "hello"
    fake.delete(ref("Pod", first.pod))
    later = next(following)
    assert (later.pod != first.pod, later.text) == (True, "early")
    following.close()  # type: ignore[attr-defined]
    assert reads == [1, None, None]


def test_lines_of_all_nodes_come_by_time(
    fake: Any, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not node after node; without a stack, levels and times are those of existing containers."""
    deploy(desired(workload("talker"), workload("listener")), fake, report=report)

    def read(self: Any, namespace: str, pod: str, *_: Any, **__: Any) -> Iterator[str]:
        start = 1 if "talker" in pod else 2
        return iter(f"2026-01-01T00:00:0{n}Z [WARN] [1.2]: {n}" for n in range(start, 7, 2))

    monkeypatch.setattr(FakeCluster, "logs", read)
    for options in (LogOptions(), LogOptions(level="warn"), LogOptions(since=60)):
        found = list(logs.logs(Settings(), [], options))
        assert [line.text[-1] for line in found] == ["1", "2", "3", "4", "5", "6"], found
        assert not any(line.note for line in found), "nothing is wrong without a stack"


RIGELFILE = """
application: {distro: noetic}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: n
      image: lab/app@sha256:%s
      nodes: {talker: {args: talk}}
      observability: {enabled: %s, grafana: {enabled: false}}
"""


@pytest.mark.parametrize("enabled", [True, False])
def test_render_and_diff_show_the_stack_that_a_job_asks_for(
    fake: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *, enabled: bool
) -> None:
    """After the application, as it is deployed; and nothing of it where it is not asked for."""
    file = tmp_path / "Rigelfile"
    file.write_text(RIGELFILE % ("ab" * 32, str(enabled).lower()))
    monkeypatch.setattr(releases, "connect", lambda settings: fake)
    rendered = releases.render(Settings(file), None).objects
    named = [(o["kind"], o["metadata"]["name"]) for o in rendered]
    assert (("Deployment", "loki") in named) is enabled
    assert ("Deployment", "talker") in named
    if enabled:
        assert named.index(("Deployment", "talker")) < named.index(("Deployment", "loki"))
    steps = [(step.ref.kind, step.ref.name) for step in releases.diff(Settings(file), None).steps]
    assert (("Deployment", "loki") in steps) is enabled
    assert ("Deployment", "talker") in steps
    assert fake.writes == []


LINES = [
    "2026-01-01T00:00:01.000000001Z [INFO] [1763728000.1]: hello",
    "2026-01-01T00:00:02.000000001Z [WARN] [1763728000.2]: late",
    "2026-01-01T00:00:03.000000001Z [ERROR] [1763728000.3]: lost",
]


@pytest.mark.parametrize(
    ("level", "said"),
    [(None, ["hello", "late", "lost"]), ("warn", ["late", "lost"]), ("error", ["lost"])],
)
def test_logs_of_a_level_are_of_that_level_and_above(
    fake: Any,
    report: Recorder,
    monkeypatch: pytest.MonkeyPatch,
    level: str | None,
    said: list[str],
) -> None:
    """What a pod itself says is filtered too, not only what is stored."""
    deploy(desired(workload()), fake, report=report)
    monkeypatch.setattr(FakeCluster, "logs", lambda *_, **__: iter(LINES))
    found = logs.logs(Settings(), [], LogOptions(level=level))
    assert [line.text.rpartition(": ")[2] for line in found if not line.note] == said


def test_diff_shows_what_others_own(
    fake: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The difference is what `diff` is for; that a deploy would be refused comes after it."""
    (tmp_path / "Rigelfile").write_text(
        "application: {distro: noetic}\n"
        "jobs:\n  deploy:\n    plugin: rigel_k8s.OrchestrationPlugin\n"
        "    with: {deployment_name: demo, namespace: n, image: a@sha256:" + "0" * 64 + ","
        " deploy_ros_master: false, nodes: {talker: {args: [talker]}}}\n"
    )
    monkeypatch.setattr(releases, "connect", lambda _: fake)
    objects = releases.render(Settings(tmp_path / "Rigelfile"), None).objects
    (ours,) = (item for item in objects if item["kind"] == "Deployment")
    theirs = copy.deepcopy(ours)
    theirs["metadata"] = {"name": "talker", "namespace": "n"}
    fake.as_manager("kubectl").create(theirs)
    found = releases.diff(Settings(tmp_path / "Rigelfile"), None)
    assert "Deployment n/talker already exists" in str(found.conflict and found.conflict.details)
    assert "+    rigel-k8s/release: demo" in found.text
    assert releases.diff(Settings(tmp_path / "Rigelfile", adopt=True), None).conflict is None


def test_a_release_without_revisions_is_no_table() -> None:
    """After `down`, or in a namespace that is misspelt."""
    with pytest.raises(UserError, match="there is no release") as error:
        releases.history(Settings(Path("Rigelfile")), None)
    assert "rigel list -A" in str(error.value.hint)


def deploy_twice(fake: Any, report: Recorder) -> None:
    for image, limit in (("app:1", 1.8), ("app:2", 1.6)):
        options = {"nodes": {"brake": {"parameters": {"limit": limit}}}}
        objects = (workload("brake", image=image), config("c" if limit > 1.7 else "d"))
        deploy(Desired(RELEASE, objects, options=options), fake, report=report)


def test_one_revision_is_shown_whole(fake: Any, report: Recorder) -> None:
    """What it changed, and the options that its job had."""
    deploy_twice(fake, report)
    entry, revision = releases.show(Settings(), None, 2)
    assert entry.changes[0] == "brake.parameters.limit: 1.8 to 1.6"
    assert revision.options["nodes"]["brake"]["parameters"] == {"limit": 1.6}


def test_no_command_about_revisions_shows_a_secret(fake: Any, report: Recorder) -> None:
    """In all shapes that `env` has in options and objects; where one comes from is shown."""
    ref = {"secretKeyRef": {"name": "cloud", "key": "key", "optional": True}}
    for n in "12":
        made = workload("brake")
        env = [{"name": "API_KEY", "value": f"hush{n}"}, {"name": "A", "value": n}]
        [container] = made["spec"]["template"]["spec"]["containers"]
        container["env"] = [*env, {"name": "CLOUD_KEY", "valueFrom": ref}]
        options = {
            "env": {"TOKEN": f"hush{n}"},
            "nodes": {
                "brake": {"env": env},
                "odd": {"env": {"PASSWORD": 7, f"OLD_KEY{n}": "hush"}},
            },
            "patches": [{"spec": {"containers": [{"name": "c", "env": env}]}}],
        }
        deploy(Desired(RELEASE, (made,), options=options), fake, report=report)
    [_, last] = releases.history(Settings(), None)
    entry, revision = releases.show(Settings(), None, 2)
    text = releases.compare(Settings(), None, 1, None)
    assert list(last.changes) == [
        "env.TOKEN: another value",
        "brake.env: another value",
        "odd.env.OLD_KEY1: (hidden) is removed",
        "odd.env.OLD_KEY2: (hidden) is new",
        "patches: another value",
    ]
    assert revision.options["env"] == {"TOKEN": "(hidden)"}
    assert {"name": "A", "value": "2"} in revision.options["nodes"]["brake"]["env"]
    assert "-          value: (hidden, as it is)\n+          value: (hidden, changed)\n" in text
    for found in (last, entry, revision.options, text):
        assert "hush" not in str(found)


@pytest.mark.parametrize(("numbers", "signs"), [((1, None), "-+"), ((1, 2), "-+"), ((2, 1), "+-")])
def test_two_revisions_are_compared(
    fake: Any, report: Recorder, numbers: tuple[int, int | None], signs: str
) -> None:
    """The second one is the newest, unless it is named."""
    deploy_twice(fake, report)
    lines = releases.compare(Settings(), None, *numbers).splitlines()
    found = {line[0]: line[1:].strip() for line in lines if "image: app" in line}
    assert found == {signs[0]: "- image: app:1", signs[1]: "- image: app:2"}
    assert f"--- ConfigMap n/c (revision {numbers[0]})" in lines
    assert releases.compare(Settings(), None, 2, None) == ""


def test_a_revision_that_is_not_kept_is_named(fake: Any, report: Recorder) -> None:
    """With those that are."""
    deploy_twice(fake, report)
    with pytest.raises(UserError, match="demo has no revision 7") as caught:
        releases.show(Settings(), None, 7)
    assert "kept: 1, 2" in str(caught.value.hint)

"""Revisions as `rigel history` and the page show them: what each changed, and a rollback would."""

from __future__ import annotations

from typing import Any

from rigel_k8s.release import revisions
from rigel_k8s.release.history import Entry, History
from rigel_k8s.release.locking import name_user
from rigel_k8s.release.types import Desired
from tests.support.manifests import RELEASE, config, workload
from tests.support.releases import deploy


def entries(fake: Any, report: Any, *releases: tuple[Any, ...]) -> list[Entry]:
    for objects in releases:
        deploy(Desired(RELEASE, objects), fake, report=report, description="an update")
    return History().make_entries(revisions.records(fake, RELEASE))


def test_a_revision_says_what_it_has_changed(fake: Any, report: Any) -> None:
    """Images by name, replicas, new and removed workloads; the rest by its keys."""
    other = workload("arm")
    pod = other["spec"]["template"]["spec"]
    pod["volumes"] = [{"name": "bags", "emptyDir": {}}]
    pod["containers"][0] |= {"env": [{"name": "FOO", "value": "1"}], "args": ["x"]}
    old = (workload("lidar"), workload("base"), workload("arm"), config("c"))
    found = entries(
        fake,
        report,
        (workload(), workload("camera"), *old),
        (
            workload(image=f"app:2@sha256:{'ab' * 32}"),
            workload("camera", replicas=0),
            workload("lidar", note="x"),
            other,
            workload("imu"),
            config("c", a="1"),
        ),
    )
    assert found[0].changes == ()
    assert list(found[1].changes) == [
        "arm: args, env FOO, volumes",
        "base is removed",
        "camera: 1 to 0 replicas",
        "imu is new",
        "lidar: changed",
        "talker: image app:1 to app:2@sha256:abababa",
    ]
    assert found[1].description == "an update"
    assert (found[1].by, found[1].status, found[0].status) == (name_user(), "good", "superseded")
    assert found[1].images == ("app:1", "app:2@sha256:abababa")


def with_files(name: str, **files: str) -> tuple[Any, Any]:
    """Return a workload and the ConfigMap with its files, which has another name if one changes."""
    made = workload()
    items = [{"key": key, "path": f"scripts/{key}.py"} for key in files]
    volume = {"name": "files-0", "configMap": {"name": name, "items": items}}
    made["spec"]["template"]["spec"]["volumes"] = [volume]
    return made, config(name, **files)


def test_a_changed_file_is_named(fake: Any, report: Any) -> None:
    """Also a new and a removed one; many are counted, and a new folder is a volume."""
    found = entries(
        fake,
        report,
        (workload(),),
        with_files("c1", a="1", b="1", c="1"),
        with_files("c2", a="2", b="1", d="1"),
        with_files("c3", e="1"),
    )
    assert [entry.changes for entry in found[1:]] == [
        ("talker: volumes",),
        ("talker: scripts/a.py, scripts/c.py, scripts/d.py",),
        ("talker: 4 files",),
    ]


def test_a_rollback_is_described_from_the_present(fake: Any, report: Any) -> None:
    """Not step by step, and not for the present revision."""
    found = entries(
        fake, report, (workload(),), (workload(image="app:2"),), (workload(image="app:3"),)
    )
    assert found[0].back == ("talker: image app:3 to app:1",)
    assert found[1].back == ("talker: image app:3 to app:2",)
    assert found[2].back == ()


def test_a_revision_is_decompressed_once(fake: Any, report: Any, monkeypatch: Any) -> None:
    """Its status changes often, its objects never."""
    deploy(Desired(RELEASE, (workload(),)), fake, report=report)
    read, real = [], revisions.decode
    monkeypatch.setattr(revisions, "decode", lambda record: read.append(1) or real(record))
    history = History()
    for _ in range(3):
        history.make_entries(revisions.records(fake, RELEASE))
    assert read == [1]


def test_options_are_shown_with_their_values(fake: Any, report: Any) -> None:
    """As the user wrote them; what differs in pods because of them is not shown again."""
    before = {
        "network": "peers",
        "nodes": {
            "brake": {
                "parameters": {"limit": 1.8, "on": True, "rate": 10.0},
                "env": {"API_TOKEN": "abc", "A": "1"},
            },
            "gone": {"args": ["x"]},
        },
    }
    after = {
        "network": "macvlan",
        "nodes": {
            "brake": {
                "parameters": {"limit": 1.6, "rate": 10},
                "env": {"API_TOKEN": "def", "A": "2"},
            },
            "imu": {"args": ["y" * 99]},
        },
        "domain_id": 7,
    }
    changed = workload("brake", image="app:2")
    changed["spec"]["template"]["spec"]["containers"][0]["args"] = ["x"]
    for objects, options in (
        ((workload("brake"), workload("gone")), before),
        ((changed, workload("imu")), after),
    ):
        deploy(Desired(RELEASE, objects, options=options), fake, report=report)
    first, second = History().make_entries(revisions.records(fake, RELEASE))
    assert list(second.changes) == [
        "domain_id: 7 is new",
        "network: peers to macvlan",
        "brake.env.A: 1 to 2",
        "brake.env.API_TOKEN: another value",
        "brake.parameters.limit: 1.8 to 1.6",
        "brake.parameters.on: true is removed",
        "brake.parameters.rate: 10.0 to 10",
        "brake: image app:1 to app:2",
        "gone is removed",
        "imu is new",
    ]
    assert "brake.parameters.limit: 1.6 to 1.8" in first.back

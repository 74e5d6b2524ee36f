"""`record` is one more node, with a volume that nothing else mounts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rigel_inpod import scripts
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.recording import FOLDER, READY, Split
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.rigelfile import load, preview, realise

from .shapes import container, env, find, options, pod, release

WAITS = """\
application: {distro: noetic}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {image: robot:1, record: {limit: "{{ data.limit }}"}, nodes: {a: {args: [a]}}}
"""
JOB = "{image: a, nodes: {b: {args: x}}, record: %s}"


def claimed(record: str) -> str:
    """Return the size of the claim."""
    found = find(release(JOB % record), "PersistentVolumeClaim", "bags-pvc")
    return str(found["spec"]["resources"]["requests"]["storage"])


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ("true", ["300s", "10737418240"]),
        ("{split: 1h30m, limit: 2G, topics: [/scan, tf]}", ["5400s", "2000000000", "/scan", "tf"]),
        ("{split: 500Mi}", ["524288000", "10737418240"]),
        (
            "{on: [breach, crash], topics: [/scan]}",
            ["60s", "10737418240", "--on=breach,crash@ros-exporter:9419", "/scan"],
        ),
    ],
)
def test_what_the_script_reads(record: str, words: list[str]) -> None:
    """Seconds or bytes of one bag, bytes of all, topics."""
    line = container(release(JOB % record), "recorder")["args"]
    assert line == ["/bin/sh", "/rigel-k8s/record.sh", FOLDER, "run", *words]


def test_the_exporter_can_be_asked_if_bags_are_kept_around_faults() -> None:
    """By the name that the recorder has; no other release needs the Service."""
    watched = "observability: {enabled: true}, expect: {/a: {rate: 1..}}"
    found = release(JOB % f"{{on: [breach]}}, {watched}")
    (port,) = find(found, "Service", "ros-exporter")["spec"]["ports"]
    assert port["port"] == 9419
    without = release(JOB % f"true, {watched}").objects
    assert {m["kind"] for m in without if m["metadata"]["name"] == EXPORTER} == {"Deployment"}


def test_the_volume_has_room_for_the_bag_that_is_written() -> None:
    """The script keeps that below a quarter of the limit."""
    assert claimed("true") == "12800Mi"
    assert claimed("{limit: 2G}") == "2384Mi"
    assert claimed("{size: 20Gi}") == "20Gi"


def test_nothing_is_recorded_by_default() -> None:
    assert "recorder" not in options(JOB % "false").nodes


def test_it_sees_all_topics_behind_a_discovery_server() -> None:
    """That shows them to super clients only."""
    for mode, value in (("discovery-server", "TRUE"), ("peers", None)):
        text = f"{{image: a, network: {mode}, ros: '2', record: true}}"
        assert env(release(text, distro="jazzy"), "recorder").get("ROS_SUPER_CLIENT") == value


def test_an_entry_of_nodes_adds_to_it() -> None:
    """Any option of a node can be set; what it runs is refused."""
    made = options("{image: a, record: true, nodes: {recorder: {env: {A: b}}, b: {args: x}}}")
    assert list(made.nodes) == ["recorder", "b"]
    assert made.nodes["recorder"].env == {"A": "b"}
    assert made.nodes["recorder"].anonymous


def test_an_application_does_not_mount_the_bags() -> None:
    """It mounts all other volumes; this one is exclusive."""
    text = (
        "{application_image: a, image: a, record: true, persistent_storage: {volumes: [{name: v}]}}"
    )
    mounted = {one["name"] for one in pod(release(text), "rigel-k8s-application")["volumes"]}
    assert mounted == {"rigel-inpod", "v"}


@pytest.mark.parametrize("text", ["5 minutes", "5x", "0s", "500ms", "-1Gi", "500mi", "0.2s"])
def test_a_split_that_is_none(text: str) -> None:
    with pytest.raises(ValueError, match="is not a duration such as 5m, or a size such as 500Mi"):
        Split.parse(text)


def test_a_limit_that_waits_for_data(tmp_path: Path) -> None:
    """It is known when the job runs."""
    (tmp_path / "Rigelfile").write_text(WAITS)
    found = load(tmp_path / "Rigelfile")
    seen = preview(found, found.jobs["deploy"], None, None, OrchestrationOptions)
    assert (seen.findings, seen.complete) == ((), False)
    data: dict[str, Any] = {"limit": "2G"}
    real = realise(found, found.jobs["deploy"], None, data, OrchestrationOptions).options
    assert "2000000000" in real.nodes["recorder"].args
    assert [volume.size for volume in real.persistent_storage.volumes] == ["2384Mi"]


def test_the_script_has_the_same_file_for_readiness() -> None:
    assert f'READY = "{READY}"' in scripts()["record.py"]

"""Loki deletes what is older than its retention: the lines, and the files that they are in."""

from __future__ import annotations

import json
import time
import urllib.request
import uuid
from collections.abc import Iterator
from typing import Any

import pytest
import yaml

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.objects.scalars import Retention
from rigel_k8s.observability.manifests.desired import loki
from rigel_k8s.observability.manifests.program import digest
from rigel_k8s.observability.manifests.stack import Stack as Parts
from rigel_k8s.observability.options import Loki, Observability
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.recorder import Recorder
from tests.support.releases import deploy

from .conftest import Stack, until

pytestmark = pytest.mark.cluster

HOUR = 3600
#: The compactor looks by the minute otherwise, and deletes two hours after it has found something.
SOON = {
    "compaction_interval": "2s",
    "apply_retention_interval": "2s",
    "retention_delete_delay": "1s",
}


def hurried(objects: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same Loki, whose compactor does not let us wait: nothing else is changed."""
    config = next(one for one in objects if one["kind"] == "ConfigMap")
    made = yaml.safe_load(config["data"]["loki.yaml"])
    made["compactor"] |= SOON
    # Queries know an index that Loki has just written for twelve minutes otherwise; now for two.
    made["storage_config"] = {
        "index_cache_validity": "1s",
        "tsdb_shipper": {"resync_interval": "2s"},
    }
    config["data"]["loki.yaml"] = yaml.safe_dump(made)
    workload = next(one for one in objects if one["kind"] == "Deployment")
    workload["spec"]["template"]["metadata"]["annotations"] = {"hurried": digest([config])}
    return objects


@pytest.fixture
def brief(cluster: Any, context: str, tmp_path: Any) -> Iterator[Stack]:
    """A Loki of a day, in a namespace of its own."""
    stack = Stack(cluster, context, f"t-retention-{uuid.uuid4().hex[:6]}", tmp_path / "none")
    put(stack, objects(stack))
    yield stack
    cluster.delete(ObjectRef("v1", "Namespace", "", stack.namespace))


def objects(stack: Stack) -> list[dict[str, Any]]:
    """What Loki is deployed as."""
    options = Observability(enabled=True, loki=Loki(retention=Retention("24h")))
    return list(loki(Parts(options, stack.namespace)))


def put(stack: Stack, made: list[dict[str, Any]]) -> None:
    """Deploy it, and return when it answers."""
    release = ReleaseId(stack.namespace, "brief")
    deploy(Desired(release, tuple(made), create_namespace=True), stack.cluster, report=Recorder())


def post(stack: Stack, path: str, body: Any = None) -> None:
    """Send something to Loki's pod, as its collector or its administrator does."""
    (pod,) = stack.pods("loki")
    with stack.cluster.port_forward(stack.namespace, pod["metadata"]["name"], {3100: 0}) as forward:
        (port,) = forward.ports.values()
        request = urllib.request.Request(
            f"http://127.0.0.1:{port}/{path}",
            data=json.dumps(body).encode() if body else b"",
            headers={"Content-Type": "application/json"},
        )
        with urllib.request.urlopen(request, timeout=60) as answer:
            assert answer.status in (200, 204)


def told(stack: Stack) -> set[str]:
    """The lines that are there."""
    return {line for _, line in stack.lines('{application="demo"}', hours=100)}


@pytest.mark.slow
def test_lines_beyond_the_retention_are_deleted(brief: Stack) -> None:
    """They are found as long as they are stored; a day later Loki gives their disk back."""
    now = time.time_ns()
    ages = {"two days ago": 48 * HOUR, "just now": 0}
    streams = [
        {
            "stream": {"application": "demo", "age": text.replace(" ", "-")},
            "values": [[str(now - age * 10**9), text]],
        }
        for text, age in ages.items()
    ]
    post(brief, "loki/api/v1/push", {"streams": streams})
    # Chunks and their index are where old lines are looked for, and the compactor looks: an end of
    # Loki writes them there.
    post(brief, "flush")
    brief.restart("loki")
    until(lambda: told(brief) == set(ages), "both lines are stored and found")
    put(brief, hurried(objects(brief)))
    until(lambda: told(brief) == {"just now"}, "the old line is deleted, and no other")
    swept = "loki_boltdb_shipper_retention_sweeper_chunk_deleted_duration_seconds_count"

    def deleted() -> bool:
        ref = ObjectRef("v1", "Service", brief.namespace, "loki")
        text = brief.cluster.get_through_proxy(ref, "metrics", port=3100).decode()
        counts = [
            line
            for line in text.splitlines()
            if line.startswith(swept) and 'status="success"' in line
        ]
        return any(float(line.split()[-1]) > 0 for line in counts)

    until(deleted, "its chunk is deleted from the disk")

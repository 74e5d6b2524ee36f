"""examples/observability: an application that runs already, watched with one key."""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.objects.refs import ObjectRef

from .conftest import TALKER, App, until

pytestmark = pytest.mark.cluster

EXAMPLE = Path(__file__).parents[4] / "examples" / "observability" / "Rigelfile"


@pytest.fixture
def unwatched(app: App, cluster: Any, base_image: str, tmp_path: Path) -> Iterator[App]:
    """A talker that nobody watches."""
    name = f"t-reading-{uuid.uuid4().hex[:6]}"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}})
    nodes = {"talker": {"args": ["python3", "-c", TALKER]}}
    options = {"image": base_image, "ros_master_image": base_image, "nodes": nodes}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    made = App(tmp_path / "Rigelfile", app.context, name)
    made.file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": {"deploy": job}}))
    made("run", "job", "deploy", "--timeout", "8m")
    yield made
    cluster.delete(ObjectRef("v1", "Namespace", "", name))


def pods(cluster: Any, app: App) -> dict[str, str]:
    """Return the UIDs of the application's pods, by their name."""
    found = cluster.list("v1", "Pod", app.namespace)
    return {pod["metadata"]["name"]: pod["metadata"]["uid"] for pod in found}


def test_the_example_restarts_nothing(unwatched: App, cluster: Any) -> None:
    """The key is laid over the release: it gains an exporter, and its nodes go on."""
    before = pods(cluster, unwatched)
    example = attrs.evolve(unwatched, file=EXAMPLE)
    example("run", "job", "watch")
    after = pods(cluster, unwatched)
    assert before.items() <= after.items()
    assert any(name.startswith("ros-exporter-") for name in after)

    def talks() -> bool:
        rows = json.loads(example("top", "-o", "json").stdout)["nodes"]
        return any(row["up"] and row["workload"] == "talker" for row in rows)

    until(talks, "the talker's health in Prometheus")
    assert "/chatter" in example("top", "--topics").stdout

"""What has golden files, as the API server sees it: networks and applications."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.cli.main import run
from tests.unit.app.test_golden import CASES as SHAPES
from tests.unit.app.test_golden import make

from .conftest import own_namespace

pytestmark = pytest.mark.cluster

GOLDEN = Path(__file__).parents[1] / "unit" / "network" / "golden"
CASES = sorted(GOLDEN.glob("*.case.yaml"))


def rigelfile(case: dict[str, Any]) -> str:
    """Return a Rigelfile that deploys a case's pods on its network."""
    names = [pod["name"] for pod in case["pods"] if pod["name"] != "ros-master"]
    options = {
        "ros": case.get("ros", "2"),
        "image": "registry.example/robot:1",
        "nodes": {name: {"args": ["run"]} for name in names},
        **case["with"],
    }
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    distro = case.get("distro", "jazzy")
    return yaml.safe_dump({"application": {"distro": distro}, "jobs": {"deploy": job}})


@pytest.fixture(scope="module")
def space(cluster: Any) -> Iterator[str]:
    """A namespace, in which nothing is made."""
    with own_namespace(cluster, "t-manifests") as name:
        yield name


@pytest.mark.parametrize("file", CASES, ids=lambda file: file.name.partition(".")[0])
def test_the_api_server_takes_every_network(
    file: Path,
    cluster: Any,
    multus: None,
    space: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A dry run on the server refuses no field of any mode's objects and pods."""
    (tmp_path / "Rigelfile").write_text(rigelfile(yaml.safe_load(file.read_text())))
    assert run(["-f", str(tmp_path / "Rigelfile"), "-n", space, "render", "deploy"], None) == 0
    made = list(filter(None, yaml.safe_load_all(capsys.readouterr().out)))
    assert "Deployment" in {item["kind"] for item in made}
    for item in made:
        cluster.apply(item, dry_run=True, force=True)


@pytest.mark.parametrize("case", SHAPES)
def test_the_api_server_takes_every_shape(
    case: str, cluster: Any, multus: None, namespace: str
) -> None:
    """Of an application's objects, too."""
    for item in make(case):
        if "namespace" in item["metadata"]:
            item["metadata"]["namespace"] = namespace
        cluster.apply(item, dry_run=True)

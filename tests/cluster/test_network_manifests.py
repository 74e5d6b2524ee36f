"""Every network that has golden files, for every distribution, as the API server itself sees it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

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


@pytest.mark.parametrize("file", CASES, ids=lambda file: file.name.partition(".")[0])
def test_the_api_server_takes_every_network(
    file: Path, rigel: Callable[..., Any], multus: None, namespace: str, tmp_path: Path
) -> None:
    """A dry run on the server refuses no field of any mode's objects and pods."""
    (tmp_path / "Rigelfile").write_text(rigelfile(yaml.safe_load(file.read_text())))
    done = rigel("-n", namespace, "diff", "deploy", cwd=tmp_path)
    assert "create" in done.stdout
    assert "Deployment" in done.stdout

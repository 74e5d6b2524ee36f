"""What a local cluster runs beside Kubernetes has the cluster's own addresses in it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_lab.cluster import addons


def corefile(objects: list[dict[str, Any]]) -> str:
    """Return CoreDNS' configuration."""
    return next(str(o["data"]["Corefile"]) for o in objects if "Corefile" in o.get("data", {}))


@pytest.mark.parametrize("servers", ["", "nameserver 192.0.2.1\n"])
def test_the_manifests_are_those_of_the_cluster(tmp_path: Path, servers: str) -> None:
    """Its registry, its DNS address, and other names only where it has name servers."""
    (tmp_path / "node1").mkdir()
    (tmp_path / "node1" / "resolv.conf").write_text(servers)
    layout: Any = SimpleNamespace(
        directory=tmp_path, registry="r:5000", addresses=SimpleNamespace(dns_service="192.0.2.10")
    )
    objects = addons.describe_objects(layout)
    deployments = {
        (o["metadata"]["namespace"], o["metadata"]["name"]): o["spec"]["template"]["spec"]
        for o in objects
        if o["kind"] == "Deployment"
    }
    assert set(deployments) == set(addons.DEPLOYMENTS)
    images = {pod["containers"][0]["image"] for pod in deployments.values()}
    assert images == {f"r:5000/rigel-k8s/{name}:1" for _, name in addons.DEPLOYMENTS}
    assert [o["spec"]["clusterIP"] for o in objects if o["kind"] == "Service"] == ["192.0.2.10"]
    assert ("forward . /etc/resolv.conf" in corefile(objects)) is bool(servers)

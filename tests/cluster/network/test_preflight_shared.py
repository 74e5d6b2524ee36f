"""Preflight where several releases share one wire."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("multus")]

SHARED = """
application: {{distro: jazzy}}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: {namespace}
      ros: none
      image: {image}
      network: {{mode: macvlan, interface: eth0, subnet: 10.202.4.0/24, ipam: static,
                 range_start: 10.202.4.7, range_end: 10.202.4.{last}}}
      nodes:
        lidar: {{command: {command}}}
"""


def test_two_releases_on_one_subnet(
    lab: Any, rigel: Any, namespace: str, tmp_path: Path, sleeping: dict[str, Any]
) -> None:
    """A static address that another release's pod has is given to nobody else; that pod is named.

    With a range in which there is another one, or what the remedy says, the deploy goes on.
    """
    other = f"{namespace}-2"
    space = {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": other}}
    lab.cluster.create(space)
    try:
        file = tmp_path / "Rigelfile"
        file.write_text(SHARED.format(namespace=namespace, last=7, **sleeping))
        rigel("run", "job", "deploy", cwd=tmp_path)
        file.write_text(SHARED.format(namespace=other, last=7, **sleeping))
        done = rigel("run", "job", "deploy", check=False, cwd=tmp_path)
        assert done.returncode == 2
        assert f"10.202.4.7 ({namespace}/lidar-" in done.stderr
        assert "[address-taken]" in done.stderr
        assert lab.cluster.list("apps/v1", "Deployment", other) == []
        text = SHARED.replace("range_end", "exclude: [10.202.4.7], range_end")
        file.write_text(text.format(namespace=other, last=8, **sleeping))
        rigel("run", "job", "deploy", cwd=tmp_path)
    finally:
        lab.cluster.delete(ObjectRef("v1", "Namespace", "", other))


@pytest.fixture
def sleeping(lab: Any) -> dict[str, Any]:
    """An image that is there, and what makes it sleep."""
    (container,) = lab.pod("any")["spec"]["containers"]
    return {"image": container["image"], "command": json.dumps(container["command"])}

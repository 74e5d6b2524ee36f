"""Clocks that differ, on a real cluster: its machines share a kernel, so one pod's Python lies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.until import until

from .conftest import Rigel, inside

pytestmark = pytest.mark.cluster

#: In the place of the image's Python: what is sent to it has another clock while /tmp/late exists.
PYTHON = """#!/bin/sh
if [ -e /tmp/late ] && [ "$4" = -c ]; then
  code=$5
  shift 5
  exec /usr/bin/python3 -S -E -B -c "import time
real = time.time
time.time = lambda: real() - 3.6
$code" "$@"
fi
exec /usr/bin/python3 "$@"
"""
WAIT = "trap 'exit 0' INT TERM; while :; do sleep 0.1; done"
LINE = "clocks: {1} is 3.6 s behind {0} (±"


def test_clocks_that_differ_are_reported(
    rigel_as_deployer: Rigel, admin: Any, namespace: str, ros2_image: str, tmp_path: Path
) -> None:
    """By `rigel status` and `rigel doctor`; both are silent while the clocks are the same."""
    rigel = rigel_as_deployer
    first, second = sorted(node["metadata"]["name"] for node in admin.nodes())[:2]
    (tmp_path / "python3").write_text(PYTHON)
    (tmp_path / "python3").chmod(0o755)
    idle = {"command": ["sh", "-c", WAIT], "ros": "none"}
    files = {"/usr/local/bin/python3": "python3"}
    nodes = {
        "right": {**idle, "placement": {"node": first}},
        "late": {**idle, "placement": {"node": second}, "files": files},
    }
    options = {"image": ros2_image, "namespace": namespace, "network": "peers", "nodes": nodes}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
    (tmp_path / "Rigelfile").write_text(yaml.safe_dump(whole))
    rigel("run", "job", "deploy", cwd=tmp_path)
    for command in ("status", "doctor"):
        assert "clocks" not in rigel(command, cwd=tmp_path).stdout
    inside(admin, namespace, "late", "touch", "/tmp/late")
    line = LINE.format(first, second)
    # A busy machine answers later than `status` waits.
    until(lambda: line in rigel("status", cwd=tmp_path).stdout, "clocks in `rigel status`", 60)
    assert f"! {line}" in rigel("doctor", cwd=tmp_path).stdout

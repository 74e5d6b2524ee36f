"""A node's `files` on a cluster: they are there, and a changed one restarts that node alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from .conftest import Rigel, pod_uids, write_idle

pytestmark = pytest.mark.cluster

#: It becomes ready if all is as it is beside the Rigelfile. As rosrun does, it searches the folder,
#: and finds the file once.
LOOK = (
    'test "$(cat /app/layout.json)" = "$(/usr/local/bin/expected)" && test -d /app/old'
    ' && test "$(find -L /maps -name lab.pgm -exec cat {} ";" | wc -c)" = 4'
)


def test_files_are_mounted_and_a_changed_one_restarts_its_node(
    rigel_as_deployer: Rigel, cluster: Any, namespace: str, registry: str, tmp_path: Path
) -> None:
    """A program, a folder with a binary file below it, and a file among those of the image."""
    (tmp_path / "maps/floor 1").mkdir(parents=True)
    (tmp_path / "maps/floor 1/lab.pgm").write_bytes(b"P5\xff\x00")
    (tmp_path / "layout.json").write_text("one")
    program = tmp_path / "expected.sh"
    program.write_text("#!/bin/sh\necho one\n")
    program.chmod(0o755)
    files = {
        "/app/layout.json": "layout.json",
        "/usr/local/bin/expected": "expected.sh",
        "/maps": "maps/",
    }
    folder = [{"memory": "1Mi", "mount_path": "/app/old"}]
    readiness = {"command": ["sh", "-c", LOOK]}
    player = {"files": files, "volumes": folder, "readiness": readiness}
    write_idle(tmp_path, namespace, registry, {"player": player, "other": {}})

    rigel_as_deployer("run", "job", "deploy", cwd=tmp_path)
    before = pod_uids(cluster, namespace)
    (tmp_path / "layout.json").write_text("two")
    program.write_text("#!/bin/sh\necho two\n")
    rigel_as_deployer("run", "job", "deploy", cwd=tmp_path)
    after = pod_uids(cluster, namespace)
    assert after["other"] == before["other"]
    assert after["player"] != before["player"]

    kept = [item["metadata"]["name"] for item in cluster.list("v1", "ConfigMap", namespace)]
    assert sum(name.startswith("player-files-") for name in kept) == 1

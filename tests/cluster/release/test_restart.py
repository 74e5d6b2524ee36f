"""`rigel restart`: new pods of one node, as it is; the next deploy changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ..conftest import Rigel, pod_uids, write_idle

pytestmark = pytest.mark.cluster


def test_a_restart_replaces_the_pods_of_a_node_alone(
    rigel_as_deployer: Rigel, cluster: Any, namespace: str, registry: str, tmp_path: Path
) -> None:
    """With the deployer's rights; neither a deploy nor `diff` sees anything to do after it."""
    write_idle(tmp_path, namespace, registry, {"motor": {}, "other": {}})
    rigel_as_deployer("run", "job", "deploy", cwd=tmp_path)
    before = pod_uids(cluster, namespace)
    rigel_as_deployer("restart", "motor", cwd=tmp_path)
    after = pod_uids(cluster, namespace)
    assert after["other"] == before["other"]
    assert after["motor"] != before["motor"]
    assert rigel_as_deployer("diff", cwd=tmp_path).stdout == ""
    rigel_as_deployer("run", "job", "deploy", cwd=tmp_path)
    assert pod_uids(cluster, namespace) == after

    done = rigel_as_deployer("restart", "moto", cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert 'did you mean "motor"?' in done.stderr

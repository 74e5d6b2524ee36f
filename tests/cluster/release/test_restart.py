"""`rigel restart`: new pods of one node, as it is; the next deploy changes nothing."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.until import until

from ..background import Background
from ..conftest import Rigel, pod_uids, write_idle

pytestmark = pytest.mark.cluster

SAYS = "echo motor begins; trap 'exit 0' INT TERM; while :; do sleep 0.1; done"


def test_a_restart_replaces_the_pods_of_a_node_alone(
    rigel_as_deployer: Rigel,
    deployer_config: Path,
    context: str,
    cluster: Any,
    namespace: str,
    registry: str,
    tmp_path: Path,
) -> None:
    """With the deployer's rights; neither a deploy nor `diff` sees anything to do after it.

    `rigel logs --follow` goes on with a container that starts again, and with the next pod.
    """
    write_idle(
        tmp_path, namespace, registry, {"motor": {"command": ["sh", "-c", SAYS]}, "other": {}}
    )
    rigel_as_deployer("run", "job", "deploy", cwd=tmp_path)
    before = pod_uids(cluster, namespace)
    place = ["-f", str(tmp_path / "Rigelfile"), "--context", context]
    place += ["--kubeconfig", str(deployer_config)]
    with Background([sys.executable, "-m", "rigel_k8s", *place, "logs", "-f", "motor"]) as running:

        def has_begun(times: int) -> bool:
            return sum("motor begins" in line for line in running.lines) == times

        until(lambda: has_begun(1), "its beginning", 120)
        end = ("exec", "motor", "--", "sh", "-c", "kill 1")
        rigel_as_deployer(*end, cwd=tmp_path, check=False)  # its connection may end first
        until(lambda: has_begun(2), "its beginning in the same pod", 120)
        rigel_as_deployer("restart", "motor", cwd=tmp_path)
        until(lambda: has_begun(3), "its beginning in the next pod", 120)
    after = pod_uids(cluster, namespace)
    assert after["other"] == before["other"]
    assert after["motor"] != before["motor"]
    assert rigel_as_deployer("diff", cwd=tmp_path).stdout == ""
    rigel_as_deployer("run", "job", "deploy", cwd=tmp_path)
    assert pod_uids(cluster, namespace) == after

    done = rigel_as_deployer("restart", "moto", cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert 'did you mean "motor"?' in done.stderr

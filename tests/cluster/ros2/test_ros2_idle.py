"""`update: {when: idle}` with a real action server: a goal ends before its server is replaced."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml

from tests.support.ros2_work import PACKAGE
from tests.support.until import until

from ..background import Background
from ..conftest import Rigel

pytestmark = pytest.mark.cluster

PATIENCE, GOAL = 120, "8"


def test_a_goal_ends_before_the_update_begins(
    rigel: Rigel, context: str, namespace: str, work_image: str, tmp_path: Path
) -> None:
    """The server is updated by Recreate, which would end it in the middle of its goal."""

    def write(version: str, within: str) -> None:
        program = {"package": PACKAGE, "executable": "worker.py", "env": {"VERSION": version}}
        worker = {**program, "update": {"strategy": "Recreate"}}
        options = {"image": work_image, "namespace": namespace, "network": "peers"}
        options |= {"nodes": {"worker": worker}, "update": {"when": "idle", "within": within}}
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
        (tmp_path / "Rigelfile").write_text(yaml.safe_dump(whole))

    write("v1", "1s")
    rigel("run", "job", "deploy", cwd=tmp_path)
    place = ["-f", str(tmp_path / "Rigelfile"), "--context", context, "exec", "worker", "--"]
    send = [sys.executable, "-m", "rigel_k8s", *place, "ros2", "run", PACKAGE, "goal.py", GOAL]
    with Background(send) as goal:
        until(lambda: goal.found("accepted"), "accepted goal", PATIENCE)
        write("v2", "1s")
        done = rigel("run", "job", "deploy", cwd=tmp_path, check=False)
        assert done.returncode == 1
        assert "not idle within 1 s: /reach has a goal in progress" in done.stderr
        write("v2", "2m")
        done = rigel("run", "job", "deploy", cwd=tmp_path)
        assert "waits: /reach has a goal in progress" in done.stdout + done.stderr
        assert goal.found("status 4"), goal.lines

"""A few seeds of bench.chaos, with an API server of their own; the campaigns are in bench/."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ..support import shared

ROOT = Path(__file__).parents[2]


@pytest.mark.cluster
def test_deploys_survive_the_faults_of_some_seeds() -> None:
    """No traceback, no hang, nothing reported as ready that is not, and a repetition completes."""
    if not shared.possible():
        pytest.skip("the local cluster needs root; name a cluster with RIGEL_TEST_CONTEXT instead")
    words = ["--seed", "1", "--runs", "3", "--workers", "3"]
    done = subprocess.run(
        [sys.executable, "-m", "bench.chaos", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 stories in " in done.stdout
    assert " 15 repeated without faults" in done.stdout

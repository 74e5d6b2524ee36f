"""The rule files as data, and promtool where there is one."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.system.cache import cache_dir
from rigel_lab.cluster.components import obtain
from rigel_stack.boards import rules


def every_rule() -> list[dict[str, Any]]:
    groups = [group for text in rules().values() for group in yaml.safe_load(text)["groups"]]
    return [rule for group in groups for rule in group["rules"]]


@pytest.fixture(scope="session")
def alerts() -> dict[str, dict[str, Any]]:
    """The alerts by name."""
    return {rule["alert"]: rule for rule in every_rule() if "alert" in rule}


@pytest.fixture(scope="session")
def recorded() -> set[str]:
    """The names of the recorded series."""
    return {rule["record"] for rule in every_rule() if "record" in rule}


@pytest.fixture(scope="session")
def promtool() -> str:
    """Prometheus' own checker: RIGEL_PROMTOOL, the PATH's, or the local cluster's."""
    built = sorted(map(str, Path(cache_dir()).glob("*/prometheus-[0-9]*/promtool")))
    found = os.environ.get("RIGEL_PROMTOOL") or shutil.which("promtool") or (built or [None])[-1]
    if found is None and os.environ.get("RIGEL_TEST_STRICT") == "1":
        return obtain(print, ["observability"]).program("promtool")
    if found is None:
        pytest.skip("no promtool: set RIGEL_PROMTOOL, or `rigel cluster up --with observability`")
    return found

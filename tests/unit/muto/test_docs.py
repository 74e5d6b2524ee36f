"""docs/muto.md and the example show what the code does."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from rigel_k8s.commands import rigelfiles
from rigel_k8s.commands.targets import job_of
from rigel_k8s.settings import Settings
from rigel_muto import archives
from rigel_muto.nodes import CARRIED, LOST
from rigel_muto.stack import SECTIONS

from .shapes import FOLDER

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "muto.md").read_text("utf-8")


def test_the_documented_rigelfile_deploys_the_stack(tmp_path: Path) -> None:
    """It passes the check, and each of its `nodes` is one of the stack."""
    (block,) = re.findall(r"^```yaml\n(.*?)^```", PAGE, re.M | re.S)
    (tmp_path / "stacks").mkdir()
    shutil.copy(FOLDER / "talker-listener.json", tmp_path / "stacks")
    file = tmp_path / "Rigelfile"
    file.write_text(block)
    assert rigelfiles.check(Settings(rigelfile=file)).render_findings() == []
    assert list(job_of(Settings(rigelfile=file), None).options.nodes) == ["talker", "r7/listener"]


def test_the_example_is_clean(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of its stack is carried over."""
    monkeypatch.setenv("REGISTRY", "localhost:5000")
    monkeypatch.setenv("BASE_IMAGE", "ros:noetic")
    settings = Settings(rigelfile=ROOT / "examples" / "muto-stack" / "Rigelfile")
    assert rigelfiles.check(settings).render_findings() == []
    nodes = job_of(settings, None).options.nodes
    assert nodes["talker"].remappings == {"chatter": "/robot7/chatter"}
    assert nodes["robot7/listener"].placement.apart_from == ["talker"]


@pytest.mark.parametrize("key", [*CARRIED, *LOST, *SECTIONS, *archives.CARRIED])
def test_each_key_of_a_stack_is_explained(key: str) -> None:
    """What it becomes, or what to do instead."""
    assert f"`{key}`" in PAGE or f"`{key}: " in PAGE

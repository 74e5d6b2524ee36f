"""What a command costs grows with the nodes, and no faster."""

from __future__ import annotations

import cProfile
import gc
import pstats
from pathlib import Path

import pytest

from rigel_k8s.app.deploying.images import Pinned
from rigel_k8s.cli.main import main
from rigel_k8s.commands import releases
from rigel_k8s.settings import Settings
from rigel_k8s.yaml_text import documents

JOB = """
application: {{distro: noetic}}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: big
      image: robots/node:1
      nodes:
{nodes}
"""
NODE = "        n{}: {{command: [rosrun, pkg, node.py], parameters: {{rate: 1}}, env: {{A: x}}}}\n"


def calls(directory: Path, nodes: int) -> int:
    """Return how many functions are called to render that many nodes: the same on any machine."""
    file = directory / f"Rigelfile-{nodes}"
    file.write_text(JOB.format(nodes="".join(NODE.format(index) for index in range(nodes))))
    profile = cProfile.Profile()
    profile.enable()
    documents(releases.render(Settings(rigelfile=file), "deploy").objects)
    profile.disable()
    return int(vars(pstats.Stats(profile))["total_calls"])


def test_a_node_costs_the_same_among_few_and_among_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thousand nodes render in about a second: no copy of a copy, no second reading."""
    # Registries have nothing to do with it, and their threads would be counted.
    monkeypatch.setattr("rigel_k8s.app.deploying.prepare.pin", lambda *_: Pinned({}))
    calls(tmp_path, 2)  # imports, caches
    few, more, many = (calls(tmp_path, nodes) for nodes in (20, 120, 220))
    assert many - more == pytest.approx(more - few, rel=0.02)
    assert (many - more) / 100 < 6_000


def test_the_command_line_seldom_looks_for_garbage(capsys: pytest.CaptureFixture[str]) -> None:
    """All values of a render are kept to its end: looking at them again and again doubles it."""
    before = gc.get_threshold()
    try:
        with pytest.raises(SystemExit):
            main(["--version"])
        assert gc.get_threshold()[0] >= 50_000
    finally:
        gc.set_threshold(*before)
    assert "version" in capsys.readouterr().out

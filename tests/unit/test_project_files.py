"""Files for those who take part: what a release must not forget."""

from __future__ import annotations

from pathlib import Path

import yaml

from rigel_k8s import __version__

ROOT = Path(__file__).parents[2]


def test_the_citation_has_the_version() -> None:
    """RELEASING.md has the places where a version stands."""
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["version"] == __version__


def test_the_workflow_runs_on_the_oldest_python() -> None:
    """Of those that pyproject.toml allows; `./run` accepts any newer one."""
    check = yaml.safe_load((ROOT / ".github" / "workflows" / "check.yml").read_text("utf-8"))
    oldest = check["jobs"]["unit"]["strategy"]["matrix"]["python"][0]
    assert f'requires-python = ">={oldest}"' in (ROOT / "pyproject.toml").read_text("utf-8")


def test_actions_are_pinned_by_their_commit() -> None:
    """A tag can be moved to other code."""
    for path in (ROOT / ".github" / "workflows").glob("*.yml"):
        for job in yaml.safe_load(path.read_text("utf-8"))["jobs"].values():
            for step in job["steps"]:
                if "uses" in step:
                    assert len(step["uses"].partition("@")[2]) == 40, step["uses"]

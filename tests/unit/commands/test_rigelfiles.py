"""`rigel check` finds what only a run would meet otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest

from rigel_k8s.commands import rigelfiles
from rigel_k8s.settings import Settings

TWO_AT_ONCE = """\
application: { distro: noetic }
jobs:
  deploy: { plugin: rigel_k8s.OrchestrationPlugin, with: { application_image: "app:1" } }
sequences:
  both:
    stages:
      - matrix: { robot: [a, b] }
        parallel: [{ jobs: [deploy] }]
  one:
    stages: [{ jobs: [deploy, deploy] }]
"""


def test_two_branches_that_deploy_one_release_are_told_with_the_sequence(tmp_path: Path) -> None:
    """What cannot run side by side is found before it runs, at its sequence."""
    path = tmp_path / "Rigelfile"
    path.write_text(TWO_AT_ONCE)
    result = rigelfiles.check(Settings(rigelfile=path))
    assert [(f.span.line, f.kind) for f in result.findings] == [(5, "side-by-side")]
    assert "deploy (robot=a) and job deploy (robot=b)" in result.findings[0].message


FLEET = """\
application: { distro: noetic }
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with: { namespace: "{{ data.robot }}", application_image: "app:1" }
sequences:
  fleet:
    stages:
      - parallel: [{ jobs: [deploy] }]
        matrix:
          robot: [r1]
          max_parallel: LIMIT
          stop_after_failures: [1]
"""


@pytest.mark.parametrize("limit", ["[0]", "[1, 2]", "[many]", "[true]", "[1.5]"])
def test_limits_of_a_matrix_are_checked_before_anything_runs(tmp_path: Path, limit: str) -> None:
    """Each is a list of one number above 0; what is wrong has its place."""
    path = tmp_path / "Rigelfile"
    path.write_text(FLEET.replace("LIMIT", limit))
    found = rigelfiles.check(Settings(path)).findings
    assert [(finding.span.line, finding.kind) for finding in found] == [(12, "bad-matrix")]


def test_a_plugin_that_rigel_cannot_import_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where Rigel 0.3 is installed and src/plugin.py is not there."""
    path = tmp_path / "Rigelfile"
    path.write_text(
        "application: {distro: noetic}\n"
        "jobs: {a: {plugin: src.plugin.OrchestrationPlugin, with: {application_image: a:1}}}\n"
    )

    def kinds() -> list[str]:
        return [one.kind for one in rigelfiles.check(Settings(rigelfile=path)).findings]

    assert "no-plugin" not in kinds()
    monkeypatch.setattr(rigelfiles, "find_spec", lambda name: object())
    assert "no-plugin" in kinds()
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "plugin.py").touch()
    assert "no-plugin" not in kinds()

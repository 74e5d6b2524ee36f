"""What docs/rigelfile.md and the README show is what the code takes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.jobs import registry
from rigel_k8s.rigelfile import check_file

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "docs" / "rigelfile.md", ROOT / "README.md"]
SNIPPETS = [
    text
    for page in PAGES
    for text in re.findall(r"```yaml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
]
REST = {
    "application": "application: {distro: noetic}\n",
    "jobs": "jobs: {build: {plugin: buildx, with: {image: x}}, deploy: {plugin: orchestration}}\n",
}


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_the_snippets_pass_the_check(snippet: str, tmp_path: Path) -> None:
    """Each is a Rigelfile, with the sections added that it does not show."""
    rest = (text for section, text in REST.items() if f"\n{section}:" not in f"\n{snippet}")
    file = tmp_path / "Rigelfile"
    file.write_text("".join([snippet, *rest]))

    def resolve(kind: str, name: str) -> Any:
        return registry.job_type(name) if kind == "job" else registry.provider_type(name)

    assert check_file(file, {"GHCR_TOKEN": "secret"}, resolve).render_findings() == []


def test_there_are_snippets() -> None:
    """The pages show the whole grammar, for ROS 1 and ROS 2."""
    assert len(SNIPPETS) >= 6

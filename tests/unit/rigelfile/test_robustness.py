"""No text, however broken, ends a check in anything but problems with places."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.rigelfile import check_file

FILES = sorted(Path(__file__).parent.glob("*/*.Rigelfile"))
PIECES = [
    *("{{ vars.x }}", "{{ data.x }}", "{{ vars.image | upper }}", "{{", "}}"),
    *("[", "]", "{", "}", ":", "- ", "\n", "  ", "\t", '"', "'", "#", "|", "? "),
    *("null", "yes", "1.10", "&a ", "*a", "<<: ", "!!int ", "name", "jobs"),
]


def broken(text: str, chance: random.Random) -> str:
    for _ in range(chance.randint(1, 4)):
        place = chance.randrange(len(text) + 1)
        if chance.random() < 0.6:
            text = text[:place] + chance.choice(PIECES) + text[place:]
        else:
            text = text[:place] + text[place + chance.randint(1, 8) :]
    return text


@pytest.mark.parametrize("seed", range(2))
def test_broken_files(seed: int, tmp_path: Path, resolve: Callable[[str, str], Any]) -> None:
    """Files that are right or wrong, broken at random places, are told off in order."""
    chance = random.Random(seed)
    file = tmp_path / "Rigelfile"
    texts = [text for text in (f.read_text() for f in FILES) if len(text) < 3000]
    for _ in range(100):
        file.write_text(broken(chance.choice(texts), chance))
        result = check_file(file, {}, resolve)
        assert all(finding.span.line > 0 for finding in result.findings)
        assert len(result.render_findings()) == len(result.findings)

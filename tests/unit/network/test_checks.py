"""Every message about `network` has a bad case in err/ and its exact words beside it.

`pytest tests/unit/network --update-golden` writes them anew.
"""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from rigel_k8s.app.checks.network import check_network
from rigel_k8s.app.generation import GENERATIONS

from ..app.shapes import options
from .shapes import GOLDEN

ERR = Path(__file__).parent / "err"


def told(text: str) -> str:
    """Return what the checks say of a case, a line for each problem."""
    case = yaml.safe_load(text)
    chosen = options(yaml.safe_dump(case["with"]))
    problems = check_network(chosen, GENERATIONS[case.get("ros", "2")], case.get("distro", "jazzy"))
    return "".join(
        f"{'.'.join(map(str, p.path))}: {'' if p.severity == 'error' else 'warning: '}"
        f"{p.message} [{p.kind}]\n"
        for p in problems
    )


@pytest.mark.parametrize("file", sorted(ERR.glob("*.yaml")), ids=lambda file: file.stem)
def test_a_bad_network_is_told(file: Path, *, update_golden: bool) -> None:
    """What cannot work is told with what to do, and all of it at once."""
    text = told(file.read_text("utf-8"))
    assert text
    golden = file.with_suffix(".out")
    if update_golden:
        golden.write_text(text, "utf-8")
    assert text == golden.read_text("utf-8")


@pytest.mark.parametrize("file", sorted(GOLDEN.glob("*.case.yaml")), ids=lambda file: file.name)
def test_a_network_that_works_is_not_blamed(file: Path) -> None:
    """Whatever has a golden file passes the checks."""
    assert told(file.read_text("utf-8")) == ""

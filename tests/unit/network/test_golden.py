"""Every mode's objects and wirings have a golden file; a changed wiring restarts robots."""

from __future__ import annotations

import pytest
import yaml

from .shapes import GOLDEN, make_objects, plan

CASES = sorted(path.name.removesuffix(".case.yaml") for path in GOLDEN.glob("*.case.yaml"))


class Dumper(yaml.SafeDumper):
    """Writes files in files as they look."""


def text_as_block(dumper: Dumper, text: str) -> yaml.ScalarNode:
    """Return a text; one of several lines as a block."""
    return dumper.represent_scalar(
        "tag:yaml.org,2002:str", text, style="|" if "\n" in text else None
    )


Dumper.add_representer(str, text_as_block)
Dumper.ignore_aliases = lambda self, data: True  # type: ignore[method-assign]


@pytest.mark.parametrize("case", CASES)
def test_networks_are_those_of_the_golden_file(case: str, *, update_golden: bool) -> None:
    """The same options give the same objects and wirings, to the last field."""
    told = plan((GOLDEN / f"{case}.case.yaml").read_text("utf-8"))
    text = yaml.dump_all(make_objects(told), Dumper=Dumper, sort_keys=False, width=100)
    golden = GOLDEN / f"{case}.yaml"
    if update_golden:
        golden.write_text(text, "utf-8")
    assert text == golden.read_text("utf-8")


def test_golden_files_have_their_case() -> None:
    """No golden file outlives its case."""
    golden = {path.stem for path in GOLDEN.glob("*.yaml") if ".case" not in path.name}
    assert golden == set(CASES)

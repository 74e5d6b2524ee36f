"""A key that another package adds: the values of its file are options, with their places there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import attrs
import pytest

from rigel_k8s import installed
from rigel_k8s.errors import ProblemsError
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import Rigelfile, check_file, load, preview, realise, render
from rigel_k8s.rigelfile.expansion import Expanded, Extension, Surroundings
from rigel_k8s.rigelfile.fields import Field
from rigel_k8s.rigelfile.findings import Finding
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import Source, Span, YamlNode
from rigel_k8s.settings import Application

TEXT = """\
application: {distro: noetic, dir: sub}
jobs: {a: {plugin: test.Wheel, with: {name: x, file: wheel.yaml}}}
"""


def attach(node: YamlNode, source: Source) -> YamlNode:
    value = {k: attrs.evolve(v, source=source) for k, v in node.value.items()}
    return attrs.evolve(node, value=value, source=source)


def bring_in(node: YamlNode, surroundings: Surroundings) -> Expanded:
    """Put the keys of `file` in its place, with a warning about each."""
    assert surroundings.directory is not None
    path = surroundings.directory / node.value["file"].value
    source = Source(str(path), path.read_text())
    root, _ = parse(source)
    assert root is not None
    found = attach(root, source).value
    rest = {key: value for key, value in node.value.items() if key != "file"}
    message = f"for {surroundings.home}"
    warning = Finding(Span(1, 1, 1, 2), message, "note", "warning", source=source)
    return Expanded(attrs.evolve(node, value={**rest, **found}), (warning,))


@attrs.frozen(kw_only=True)
class Wheel:
    """A wheel."""

    extended_by: ClassVar[str] = "test.options"

    name: str
    radius: float = 0.1


class Job:
    options = Wheel

    def check(self, options: Wheel, application: Application) -> Iterator[Problem]:
        if options.radius > 1:
            yield Problem(("radius",), "too large", "big")
        if options.name == "x":
            yield Problem(("name",), "too short", "small", severity="warning")


@pytest.fixture
def rigelfile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A Rigelfile, where a package is installed that adds `file` to Wheel."""
    field = Field("file", "file", (), str, required=False, default=None, doc="")
    entry = SimpleNamespace(name="file", value="", load=lambda: Extension(field, bring_in))
    offered = {"test.options": (entry,)}
    monkeypatch.setattr(installed, "list_entries", lambda group: offered.get(group, ()))
    (tmp_path / "sub").mkdir()
    (tmp_path / "Rigelfile").write_text(TEXT)
    return tmp_path / "Rigelfile"


def loaded(rigelfile: Path, wheel: str) -> Rigelfile:
    (rigelfile.parent / "sub" / "wheel.yaml").write_text(wheel)
    return load(rigelfile)


def test_values_of_the_other_file_are_the_options(rigelfile: Path) -> None:
    """Also in the plain data that is recorded; what is only a warning stops nothing."""
    found = loaded(rigelfile, "radius: 0.5\n")
    real = realise(found, found.jobs["a"], None, {}, Wheel)
    assert real.options == Wheel(name="x", radius=0.5)
    assert real.raw == {"name": "x", "radius": 0.5}
    assert [warning.message for warning in real.findings] == [f"for {rigelfile.parent}"]
    seen = preview(found, found.jobs["a"], None, None, Wheel)
    assert seen.options == real.options
    assert seen.findings == real.findings


def test_problems_are_placed_in_the_file_that_they_are_about(rigelfile: Path) -> None:
    """Those of a value's form, those of a check, and those of the Rigelfile itself."""
    found = loaded(rigelfile, "# a wheel\nradius: wide\n")
    with pytest.raises(ProblemsError) as caught:
        realise(found, found.jobs["a"], None, {}, Wheel)
    other = rigelfile.parent / "sub" / "wheel.yaml"
    assert any(text.startswith(f"{other}:2:9: expected a number") for text in caught.value.details)
    loaded(rigelfile, "\n\nradius: 5\n")
    result = check_file(rigelfile, {}, lambda *_: Job())
    texts = [render(result.source, finding).split("\n") for finding in result.findings]
    assert [text[0] for text in texts] == [
        f"{rigelfile}:2:45: warning: too short [small]",
        f"{other}:1:1: warning: for {rigelfile.parent} [note]",
        f"{other}:3:9: too large [big]",
    ]
    assert texts[2][1] == "3 | radius: 5"

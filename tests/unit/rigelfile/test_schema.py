"""The JSON schema says what a check says, the reference says what both mean."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.commands import rigelfiles
from rigel_k8s.jobs import registry
from rigel_k8s.rigelfile import check_file, render_starter, schema
from tools.reference.options import write_options

HERE = Path(__file__).parent
ROOT = HERE.parents[2]


@pytest.fixture
def validator(types: Any) -> Draft202012Validator:
    """A validator with the tests' own types."""
    made = schema({("test.Robot",): types["Robot"]}, {("test.Shop",): types["Account"]})
    Draft202012Validator.check_schema(made)
    return Draft202012Validator(made)


@pytest.fixture
def real() -> Draft202012Validator:
    """A validator with this package's types."""
    return Draft202012Validator(rigelfiles.schema())


def errors(validator: Draft202012Validator, document: Any) -> list[str]:
    return [".".join(map(str, error.absolute_path)) for error in validator.iter_errors(document)]


@pytest.mark.parametrize("file", sorted((HERE / "ok").glob("*.Rigelfile")), ids=lambda f: f.stem)
def test_the_schema_takes_what_a_check_takes(file: Path, validator: Draft202012Validator) -> None:
    """A file that is clean for us is clean in an editor."""
    if file.stem == "left-to-those-who-use-it":
        pytest.skip("a schema cannot see who uses a job")
    document = yaml.load(file.read_text(), Loader=yaml.CSafeLoader)
    assert errors(validator, document) == []


def mistakes() -> Iterator[tuple[str, str, Any]]:
    yield "jobs.r.with", "image", None
    yield "jobs.r.with", "imgae", "x"
    yield "jobs.r.with.port", "port", "http"
    yield "jobs.r.with.enabled", "enabled", "maybe"
    yield "jobs.r.with.mode", "mode", "fats"
    yield "jobs.r.with.wheels", "wheels", [{"nam": "x"}]


@pytest.mark.parametrize(("place", "key", "value"), list(mistakes()))
def test_the_schema_refuses_mistakes(
    validator: Draft202012Validator, place: str, key: str, value: Any
) -> None:
    """Unknown and missing keys and wrong types are marked, by the plugin's name."""
    options = {"image": "x", key: value}
    if value is None:
        del options[key]
    for shape in (options, {"robot": options}):
        job = {"plugin": "test.Robot", "with": shape}
        document = {"application": {"distro": "noetic"}, "jobs": {"r": job}}
        nested = place.replace("with", "with.robot") if "robot" in shape else place
        assert errors(validator, document) == [nested]


def test_templates_may_stand_anywhere(validator: Draft202012Validator) -> None:
    """A template is no mistake, whatever its value will be."""
    options = dict.fromkeys(("port", "mode", "wheels", "limits", "ready"), "{{ vars.x }}")
    job = {"plugin": "test.Robot", "with": {"image": "x", "{{ vars.key }}": 1, **options}}
    document = {"application": {"distro": "noetic"}, "jobs": {"r": job}}
    assert errors(validator, document) == []


def test_descriptions_come_from_the_classes(validator: Draft202012Validator) -> None:
    """Metadata, or else the docstring's list of attributes."""
    definitions = validator.schema["$defs"]
    assert definitions["Robot"]["properties"]["image"]["description"] == "what to run"
    assert definitions["Ready"]["properties"]["command"]["description"] == "what to ask, in words"
    assert definitions["Ready"]["description"] == "When it is ready."


@pytest.mark.parametrize("name", ["1", "2", "examples/ros1-talker-listener/Rigelfile"])
def test_our_own_rigelfiles_are_clean(
    name: str, real: Draft202012Validator, tmp_path: Path
) -> None:
    """What `rigel init` writes and what the examples show passes the check and the schema."""
    text = (
        render_starter(GENERATIONS[name].starter)
        if name in GENERATIONS
        else (ROOT / name).read_text()
    )
    file = tmp_path / "Rigelfile"
    file.write_text(text)

    environ = {"REGISTRY": "localhost:5000", "BASE_IMAGE": "ros:noetic"}
    assert check_file(file, environ, partial(registry.resolve, None)).render_findings() == []
    assert errors(real, yaml.safe_load(text)) == []


def test_the_reference_is_up_to_date(update_golden: bool) -> None:  # noqa: FBT001 - a fixture
    """docs/reference.md is made from the classes; --update-golden writes it anew."""
    text = write_options()
    page = ROOT / "docs" / "reference.md"
    if update_golden:
        page.write_text(text)
    assert page.read_text() == text


def test_every_option_is_documented() -> None:
    """No key of ours is left without a word on it."""
    rows = [line for line in write_options().splitlines() if line[:3] == "| `"]
    assert len(rows) > 50
    assert [row for row in rows if row.rstrip(" |").count("|") < 4] == []

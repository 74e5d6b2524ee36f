"""Values become what their option wants without loss, or are refused; never something else."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NewType

import attrs
import pytest

from rigel_k8s.rigelfile import Source, Structured, structure
from rigel_k8s.rigelfile.parse import parse


class Level(enum.Enum):
    LOW = "low"


class Name(str):
    kind = "bad-name"
    expects = "a name"

    @classmethod
    def parse(cls, raw: str) -> Name:
        if not raw.islower():
            raise ValueError("small letters, please")
        return cls(raw)


class Whole(int):
    kind = "bad-whole"

    @classmethod
    def parse(cls, raw: str) -> Whole:
        return cls(raw)


class Part(float):
    @classmethod
    def parse(cls, raw: str) -> Part:
        return cls(raw)


@attrs.frozen
class Leaf:
    name: str
    size: int = 1


@attrs.frozen
class Other:
    title: str
    size: int = 1


Scalar = str | int | float | bool


def structured(text: str, kind: Any) -> Structured:
    root, findings = parse(Source("f", text))
    assert root is not None
    assert not findings
    return structure(root, kind)


def accepted(text: str, kind: Any) -> Any:
    result = structured(text, kind)
    assert result.problems == ()
    return result.value


def refused(text: str, kind: Any) -> list[str]:
    result = structured(text, kind)
    assert result.value is None
    return [problem.kind for problem in result.problems]


SAMPLES = {
    "true": bool,
    "yes": bool,
    "1": int,
    "0o17": str,
    "017": int,
    "1.5": float,
    "1.10": float,
    "1e3": str,
    '"1"': str,
    '"true"': str,
    "word": str,
    "null": type(None),
    "[1]": list,
    "{a: 1}": dict,
    "2021-01-01": str,
}
#: What each type takes; all other samples are refused.
TAKES = {
    bool: {"true", "yes"},
    int: {"1", "017"},
    float: {"1", "017", "1.5", "1.10"},
    str: {text for text, kind in SAMPLES.items() if kind in (int, float, str)},
    Name: {"word", "0o17", "1e3", '"true"'},
    Whole: {"1", "017"},
    Path: {text for text, kind in SAMPLES.items() if kind in (int, float, str)},
    list[int]: {"[1]"},
    Sequence[str]: {"[1]"},
    Mapping[str, int]: {"{a: 1}"},
    Literal["word", "other"]: {"word"},
    Literal[1, 2]: {"1", '"1"'},
    Level: set(),
    Leaf: set(),
    type(None): {"null"},
}


@pytest.mark.parametrize("kind", TAKES, ids=str)
@pytest.mark.parametrize("text", SAMPLES)
def test_each_type_takes_its_own_values_only(kind: Any, text: str) -> None:
    """true is no number, 1 no boolean, and quotes make text; of a list or mapping nothing else."""
    if text in TAKES[kind]:
        accepted(text, kind)
    else:
        assert refused(text, kind)


@pytest.mark.parametrize("text", SAMPLES)
def test_anything_stays_what_yaml_says(text: str) -> None:
    """A value without a type of its own is plain data."""
    assert isinstance(accepted(text, Any), SAMPLES[text])


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("1.10", str, "1.10"),
        ("017", str, "017"),
        ("1_000", str, "1_000"),
        ("22:30", str, "22:30"),
        ("2021-01-01", str, "2021-01-01"),
        ("0x10", int, 16),
        ("017", int, 15),
        ("1", float, 1.0),
        ("a/b", Path, Path("a/b")),
        ("[a, 1.10]", list[str], ["a", "1.10"]),
        ("[a]", tuple[str, ...], ("a",)),
        ("[a]", set[str], {"a"}),
        ("{a: {name: b}}", dict[str, Leaf], {"a": Leaf("b")}),
        ("{word: 1}", Mapping[Name, int], {"word": 1}),
        ("{1: a}", Mapping[int, str], {1: "a"}),
        ("null", int | None, None),
        ("low", Level, Level.LOW),
        ("a", Annotated[str, "x"], "a"),
        ("a", NewType("Word", str), "a"),
        ("1", Part, Part(1)),
    ],
)
def test_values_are_converted_without_loss(text: str, kind: Any, value: Any) -> None:
    """Text keeps the digits that were written; numbers are YAML's."""
    result = accepted(text, kind)
    assert result == value
    assert type(result) is type(value)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("word", str | list[str], "word"),
        ("[word]", str | list[str], ["word"]),
        ("1", str | int, 1),
        ('"1"', str | int, "1"),
        ("1", int | float, 1),
        ("1.5", int | float, 1.5),
        ("true", Scalar, True),
        ("word", Literal["word"] | Leaf, "word"),
        ("{name: x}", Literal["word"] | Leaf, Leaf("x")),
        ("{title: x}", Leaf | Other, Other("x")),
        ("80", Whole | Leaf | None, Whole(80)),
        ("80", Whole | None | str, Whole(80)),
        ("{a: 1}", Mapping[str, int] | list[str], {"a": 1}),
        ("[{name: x}]", list[Name | Leaf], [Leaf("x")]),
    ],
)
def test_a_union_takes_the_member_that_fits(text: str, kind: Any, value: Any) -> None:
    """The member of the value's own kind is taken, before one that it could be made."""
    assert accepted(text, kind) == value


def test_a_number_where_text_may_stand_keeps_its_digits() -> None:
    """`VERSION: 1.10` is a number that says 1.10."""
    value = accepted("1.10", Scalar)
    assert value == 1.1
    assert isinstance(value, float)
    assert str(value) == "1.10"
    assert str(accepted("0644", Scalar)) == "0644"


@pytest.mark.parametrize("kind", [str, Scalar, str | list[str], Name | None])
@pytest.mark.parametrize("text", ["yes", "no", "on", "off", "Yes", "OFF"])
def test_a_yaml_1_1_boolean_is_no_text(text: str, kind: Any) -> None:
    """Where text may stand, yes and its like must be quoted, since nobody knows what is meant."""
    assert refused(text, kind) == ["yaml-boolean"]


def test_a_stage_type_is_chosen_by_its_keys() -> None:
    """A misspelt key is not blamed on another class of the union."""
    problems = structured("{title: x, sise: 2}", Leaf | Other).problems
    assert [p.message for p in problems] == ['unknown key "sise", did you mean "size"?']
    problems = structured("{titel: x}", Leaf | Other).problems
    assert [p.message for p in problems] == ['unknown key "titel", did you mean "title"?']


def test_all_problems_have_their_paths() -> None:
    """Nothing hides anything; paths lead through lists and mappings."""
    text = "{a: [{name: x, size: y}, {nam: x}, 1], b: [{name: [], size: 1.5}]}"
    problems = structured(text, Mapping[str, list[Leaf]]).problems
    assert [problem.path for problem in problems] == [
        ("a", 0, "size"),
        ("a", 1, "nam"),
        ("a", 2),
        ("b", 0, "name"),
        ("b", 0, "size"),
    ]


def test_a_draft_has_defaults_for_what_is_wrong() -> None:
    """A check can look at the rest of the options, and knows where not to."""
    result = structured("{a: {name: x, size: y}, b: {size: 1}}", Mapping[str, Leaf])
    assert result.draft == {"a": Leaf("x", 1)}
    assert result.doubts.may_explain(("a", "size"))
    assert result.doubts.may_explain(("b", "name"))
    assert not result.doubts.may_explain(("a", "name"))


def test_a_validator_of_the_class_is_heard() -> None:
    """What a class refuses in its constructor is a problem at its mapping."""

    @attrs.frozen
    class Positive:
        number: int = attrs.field(validator=attrs.validators.gt(0))

    assert refused("{number: 0}", Positive) == ["bad-value"]


def test_metadata_gives_keys() -> None:
    """A field may have another key in the file, and further ones."""

    @attrs.frozen
    class Named:
        with_: int = attrs.field(default=0, metadata={"key": "with", "aliases": ("using",)})

    assert accepted("{with: 1}", Named) == Named(1)
    assert accepted("{using: 1}", Named) == Named(1)
    assert refused("{with_: 1}", Named) == ["unknown-key"]
    assert refused("{with: 1, using: 2}", Named) == ["duplicate-key"]

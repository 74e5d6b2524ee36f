"""Parameter files are read as ROS reads them, and compared with the name of the node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.app.deploying.parameterfiles import check_parameter_files
from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.app.generations.ros2files import check_file, nest_parameters
from tests.support.ros_parameters import MATCHING, VALUES, WRONG

from .shapes import options


@pytest.mark.parametrize(("text", "at_root", "below"), MATCHING)
def test_keys_are_those_that_rcl_matches(
    text: str,
    at_root: bool,  # noqa: FBT001 - a parameter
    below: bool,  # noqa: FBT001 - a parameter
) -> None:
    """A file with the parameters of other nodes only is a warning."""
    for name, found in (("/mapper", at_root), ("/r1/mapper", below)):
        faults = list(check_file(text, name))
        assert [fault.ends for fault in faults] == ([] if found else [False])
        assert all(fault.message.startswith(f"no parameters for {name} ") for fault in faults)
    assert list(check_file(text, None)) == []


@pytest.mark.parametrize("text", WRONG)
def test_a_file_with_which_a_node_ends_is_refused(text: str) -> None:
    faults = list(check_file(text, "/mapper"))
    assert faults
    assert faults[0].ends
    assert faults[0].mark


@pytest.mark.parametrize(("value", "read"), [*VALUES, ("null", ...), ("[a, ~]", ...), ("{}", ...)])
@pytest.mark.parametrize("before", ["", "/**:\n  ros__parameters:\n    "])
def test_values_are_those_that_rcl_has_a_type_for(value: str, read: Any, before: str) -> None:
    """In a plain file and in one of nodes; of `null` rcl makes a text."""
    assert bool(list(check_file(f"{before}x: {value}", "/mapper"))) is (read is ...)


def test_what_a_file_lacks_is_named() -> None:
    other = "/planner: {ros__parameters: {a: 1}}"
    messages = [fault.message for fault in check_file(other, "/r1/planner")]
    assert messages == ["no parameters for /r1/planner in this file; its key is /planner"]
    for key, ends in (("mapper", False), ("/mapper", True), ("/**", True)):
        (fault,) = check_file(f"{key}: {{a: 1}}", "/mapper")
        assert (fault.ends, fault.mark) == (ends, (1, 1))
        assert f"write {key}: {{ros__parameters: ...}}" in fault.message
    assert list(check_file("pid: {p: 1.0}", "/mapper")) == []
    assert list(check_file("eye: {ros__parameters: {a: 1}}", "/box", ["/eye"])) == []


@pytest.mark.parametrize(
    "text",
    [
        "--- # note\na: {b: 1}",
        "---\na: {b: 1}\n...\n",
        "--- {a: {b: 1}}",
        "a: {b: 1}\n... # end",
        "# c\n\na:\n  b: 1",
        "\ufeffa: {b: 1}\n",
        "%YAML 1.1\n---\na: {b: 1}\n",
    ],
)
def test_a_plain_file_is_valid_for_any_node(text: str) -> None:
    """However its document begins and ends; a line of a text is none of both."""
    assert yaml.safe_load(nest_parameters(text)) == {"/**": {"ros__parameters": {"a": {"b": 1}}}}
    note = "t: |-\n  ---\n  x"
    assert yaml.safe_load(nest_parameters(note))["/**"]["ros__parameters"]["t"] == "---\nx"


#: A node of ROS 1 or 2, its file, and the severity of what is wrong with it.
USES = [
    ("2", "args: x", "b: {ros__parameters: {a: 1}}", "warning"),
    ("2", "args: x, name: b", "b: {ros__parameters: {a: 1}}", None),
    ("2", "args: x, namespace: /r1", "n: {ros__parameters: {a: 1}}", "warning"),
    ("2", "args: x, anonymous: true", "b: {ros__parameters: {a: 1}}", None),
    ("2", "args: x, anonymous: true", "a:", "error"),
    (
        "2",
        "launch: {file: a.py, args: {f: /rigel-k8s-parameters/0}}",
        "b: {ros__parameters: }",
        None,
    ),
    ("1", "args: x", "a:", "error"),
    ("1", "args: x", "a: 5000000000", "error"),
    ("1", "args: x", "a: {1: b}", "error"),
    ("1", "args: x", "a: 2020-01-01", "error"),
    ("1", "args: x", "a: [1, b, []]", None),
    ("1", "args: x", "a: !degrees 90\nb: !radians 3.14\nc: deg(3)", None),
    ("1", "args: x", "n: {ros__parameters: {a: 1}}", "warning"),
    ("1", "args: x", "a: $(find p)/b", "warning"),
    ("2", "args: x", "a: [$(find-pkg-share p)/b, $(env C)]", "warning"),
    ("2", "args: x", "# as $(find p)\na: $(date)", None),
]


@pytest.mark.parametrize(("ros", "node", "text", "severity"), USES)
def test_a_use_of_a_file_has_its_place(
    tmp_path: Path, ros: str, node: str, text: str, severity: str | None
) -> None:
    (tmp_path / "p.yaml").write_text(text)
    job = options(
        f"{{image: a, ros: '{ros}', nodes: {{n: {{{node}, parameter_files: [p.yaml]}}}}}}"
    )
    found = list(check_parameter_files(job, GENERATIONS[ros], tmp_path, tmp_path))
    assert [one.severity for one in found] == ([severity] if severity else [])
    assert all(one.path == ("nodes", "n", "parameter_files", 0) for one in found)
    assert all(one.message.startswith("p.yaml") for one in found)

"""A job's `with` becomes its options: overridden, filled, structured, and placed in the file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ProblemsError
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import Rigelfile, preview, realise
from rigel_k8s.rigelfile.model import Sequential

Loader = Callable[..., Rigelfile]

FILE = """
vars: {wheels: [{name: a}]}
jobs:
  robot:
    plugin: test.Robot
    with:
      robot: {image: one, count: 1, wheels: "{{ vars.wheels }}"}
      size: 7
  direct:
    plugin: test.Robot
    with: {image: "{{ data.image }}", count: "{{ data.count }}", enabled: "{{ data.on }}"}
sequences:
  demo:
    stages:
      - jobs:
          - {name: robot, with: {count: 2}}
          - {name: robot, with: {robot: {image: two, size: 8}}}
          - direct
"""


def use(rigelfile: Rigelfile, number: int) -> Any:
    stage = rigelfile.sequences["demo"].stages[0]
    assert isinstance(stage, Sequential)
    job = stage.jobs[number]
    return rigelfile.jobs[job.name], job.overrides


def test_overrides_replace_whole_keys(loaded: Loader, types: Any) -> None:
    """Shallowly, as in Rigel; keys below the class's own and beside it are one level."""
    rigelfile = loaded(FILE)
    first = realise(rigelfile, *use(rigelfile, 0), {}, types["Robot"]).options
    assert (first.image, first.count, first.size) == ("one", 2, "7")
    second = realise(rigelfile, *use(rigelfile, 1), {}, types["Robot"])
    assert (second.options.image, second.options.count, second.options.size) == ("two", 1, "8")
    assert second.raw == {"robot": {"image": "two", "size": 8}, "size": 7}


def test_data_takes_the_type_that_the_option_wants(loaded: Loader, types: Any) -> None:
    """Text of an earlier job becomes a number or a boolean where it is one."""
    rigelfile = loaded(FILE)
    data = {"image": "x", "count": "12", "on": "false"}
    options = realise(rigelfile, *use(rigelfile, 2), data, types["Robot"]).options
    assert (options.image, options.count, options.enabled) == ("x", 12, False)


def test_environment_takes_the_type_that_the_option_wants(loaded: Loader, types: Any) -> None:
    """A variable's text becomes a number or a boolean where it is one, and is text elsewhere."""
    rigelfile = loaded(
        """
jobs:
  robot:
    plugin: test.Robot
    with:
      image: "{{ vars.N }}"
      count: "{{ vars.N }}"
      port: "{{ vars.N }}{{ vars.N }}"
      enabled: "{{ vars.OFF }}"
      env: {A: "{{ vars.N }}"}
      speed: "{{ vars.N }}"
      seconds!: "{{ vars.N | default(1) }}"
""",
        {"N": "7", "OFF": "off"},
    )
    options = realise(rigelfile, rigelfile.jobs["robot"], None, {}, types["Robot"]).options
    assert (options.image, options.count, options.port, options.enabled) == ("7", 7, 77, False)
    assert options.env == {"A": "7"}
    assert (options.speed, options.seconds) == (7.0, 7)


def test_a_preview_knows_what_waits(loaded: Loader, types: Any) -> None:
    """Text keeps its template, other values have their defaults; nothing is wrong about them."""
    rigelfile = loaded(FILE)
    seen = preview(rigelfile, *use(rigelfile, 2), None, types["Robot"])
    assert seen.findings == ()
    assert not seen.complete
    assert (seen.options.image, seen.options.count) == ("{{ data.image }}", 1)
    seen = preview(
        rigelfile, *use(rigelfile, 2), {"image": "x", "count": 2, "on": True}, types["Robot"]
    )
    assert seen.complete
    assert seen.options.count == 2


def test_missing_data_is_an_error_with_its_place(loaded: Loader, types: Any) -> None:
    """A job that runs needs all of it."""
    rigelfile = loaded(FILE)
    with pytest.raises(ProblemsError, match="has 2 problems") as caught:
        realise(rigelfile, *use(rigelfile, 2), {"image": "x"}, types["Robot"])
    assert caught.value.exit_code == 2
    assert "12:47: no earlier job has stored data.count" in caught.value.details[0]


def test_problems_of_a_check_are_placed(loaded: Loader, types: Any) -> None:
    """Paths begin at the options, wherever in the file those stand."""
    rigelfile = loaded(FILE)
    real = realise(rigelfile, *use(rigelfile, 0), {}, types["Robot"])
    finding = real.place_problems([Problem(("wheels", 0, "name"), "x", "y")])[0]
    assert (finding.span.line, finding.span.column) == (8, 45)
    assert finding.defined_at is not None
    assert finding.defined_at.line == 3
    finding = real.place_problems([Problem(("count",), "x", "y", at_key=True)])[0]
    assert (finding.span.line, finding.span.column) == (17, 34)


def test_free_options_are_plain_data(loaded: Loader) -> None:
    """A job type whose options are a dict gets the `with` as it is."""
    rigelfile = loaded("jobs: {a: {plugin: x, with: {b: [1, '{{ data.c }}']}}}\n")
    real = realise(rigelfile, rigelfile.jobs["a"], None, {"c": 2}, dict)
    assert real.options == real.raw == {"b": [1, 2]}


def test_keys_may_wait_for_data(loaded: Loader, types: Any) -> None:
    """What such a key will be is not known, so nothing is said to be unknown or missing."""
    rigelfile = loaded(
        """
jobs:
  robot:
    plugin: test.Robot
    with: {"{{ data.key }}": x, env: {"{{ data.name }}": y}, named: {"{{ data.size }}": {name: a}}}
"""
    )
    spec = rigelfile.jobs["robot"]
    seen = preview(rigelfile, spec, None, None, types["Robot"])
    assert seen.findings == ()
    assert not seen.complete
    data = {"key": "image", "name": "N", "size": "1Mi"}
    options = realise(rigelfile, spec, None, data, types["Robot"]).options
    assert (options.image, options.env, list(options.named)) == ("x", {"N": "y"}, ["1Mi"])

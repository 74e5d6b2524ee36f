"""Templates mean what they mean to Rigel 0.3; expressions go further and change nothing of that."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ProblemsError
from rigel_k8s.rigelfile import Rigelfile, YamlNode, strip_places

Loader = Callable[..., Rigelfile]

VARS = """
vars:
  image: ros
  base-image: ros:noetic
  base: 7
  items: [a, b]
  keys: {x: 1, "y": [2]}
  version: 1.10
  mode: 0644
  flag: yes
  count: 3
  a.b: dotted
  odd?!: odd
  ref: "{{ vars.image }}:{{ vars.version }}"
"""


def given(loaded: Loader, text: str, environ: dict[str, str] | None = None) -> Any:
    quoted = text.replace("'", "''")
    rigelfile = loaded(f"{VARS}  it: '{quoted}'\n", environ)
    return rigelfile.vars["it"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("{{ vars.image }}", "ros"),
        ("{{vars.image}}", "ros"),
        ("  {{ vars.count }} ", 3),
        ("{{ vars.items }}", ["a", "b"]),
        ("{{ vars.keys }}", {"x": 1, "y": [2]}),
        ("{{ vars.keys.y }}", [2]),
        ("{{ vars.flag }}", True),
        ("{{ vars.base-image }}", "ros:noetic"),
        ("{{ vars.a.b }}", "dotted"),
        ("{{ vars.odd?! }}", "odd"),
        ("v{{ vars.version }}", "v1.10"),
        ("{{ vars.mode }} {{ vars.flag }}", "0644 yes"),
        ("{{ vars.ref }}", "ros:1.10"),
        ("{{ vars.HOME }}/x", "/home/me/x"),
        ("${#a[@]} {# x #} {% y %}", "${#a[@]} {# x #} {% y %}"),
        ("{ vars.image }", "{ vars.image }"),
        ("}} {", "}} {"),
    ],
)
def test_plain_names(loaded: Loader, text: str, value: Any) -> None:
    """One template alone keeps its type, others become text as written; nothing else is touched."""
    environ = {"HOME": "/home/me", "image": "not this one"}
    assert given(loaded, text, environ) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("{{ vars.base-image | regex_replace('.*:', '') }}", "noetic"),
        ("{{ vars.base-image|upper }}", "ROS:NOETIC"),
        ("{{ vars.items | join('-') }}", "a-b"),
        ("{{ vars.items + ['c'] }}", ["a", "b", "c"]),
        ("{{ vars.items | map('upper') }}", ["A", "B"]),
        ("{{ vars.base-image.split(':')[1] }}", "noetic"),
        ("{{ vars['base-image'] | length }}", 10),
        ("{{ vars.count + 1 }}", 4),
        ("{{ vars.base-1 | int }}", 6),
        ("x{{ vars.count * 2 }}y", "x6y"),
        ("{{ vars.version | replace('.', '_') }}", "1_10"),
        ("{{ vars.version ~ '-rc' }}", "1.10-rc"),
        ("{{ vars.version | default(2) }}", 1.1),
        ("{{ vars.nothing | default('x') }}", "x"),
        ("{{ vars.HOME | default('x') }}", "/home/me"),
        ("{{ vars.flag and 'on' or 'off' }}", "on"),
        ("{{ 'a' if vars.count > 2 else 'b' }}", "a"),
        ("{{ 'vars.image' }}", "vars.image"),
        ("{{ '{{' }} }}", "{{ }}"),
        ("{{ '{{ vars.image }}' }}", "{{ vars.image }}"),
        ("{{ {'a': {'b': 1}} }}", {"a": {"b": 1}}),
        ("{{ [vars.flag] }}", [True]),
        ("is {{ vars.count == 3 }}", "is true"),
        ("{{ 'a.b.a' | regex_replace('A', 'x', ignorecase=true, count=1) }}", "x.b.a"),
        ("{{ vars.base-image | regex_replace('(.*):(.*)', '\\\\2-\\\\1') }}", "noetic-ros"),
    ],
)
def test_expressions(loaded: Loader, text: str, value: Any) -> None:
    """Filters and arithmetic work on vars whatever their names are."""
    assert given(loaded, text, {"HOME": "/home/me"}) == value


@pytest.mark.parametrize(
    "text",
    [
        "{{ ''.__class__ }}",
        "{{ [].__class__.__base__.__subclasses__() }}",
        "{{ vars.items.append('c') }}",
        "{{ ('' | attr('__class__')) }}",
        "{{ lipsum() }}",
    ],
)
def test_expressions_reach_nothing_of_python(loaded: Loader, text: str) -> None:
    """The sandbox refuses what leads out of it, and changes no value."""
    with pytest.raises(ProblemsError):
        given(loaded, text)


def test_keys_are_templates_too(loaded: Loader) -> None:
    """A key may be or contain a template; in Rigel it may only be one."""
    rigelfile = loaded(VARS + '  it: {"{{ vars.image }}": 1, "a-{{ vars.count }}": 2}\n')
    assert rigelfile.vars["it"] == {"ros": 1, "a-3": 2}


def test_vars_win_over_the_environment(loaded: Loader) -> None:
    """The environment is asked only for what vars does not have; its text is not interpreted."""
    environ = {"image": "no", "OTHER": "{{ vars.image }}"}
    assert given(loaded, "{{ vars.image }}-{{ vars.OTHER }}", environ) == "ros-{{ vars.image }}"


JOB = """
jobs:
  job: {plugin: test.Free, with: %s}
"""


def fill(
    rigelfile: Rigelfile, data: dict[str, Any], *, final: bool = False
) -> tuple[YamlNode, list[str]]:
    """Return the options of the file's job with data filled in, and what is wrong with them."""
    scope = rigelfile.scope.with_data(data, final=final)
    node = scope.fill(rigelfile.jobs["job"].options)
    return node, [finding.message for finding in scope.findings]


def filled(loaded: Loader, text: str, data: dict[str, Any], *, final: bool = True) -> Any:
    node, messages = fill(loaded(VARS + JOB % text), data, final=final)
    return messages or strip_places(node)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("{{ data.n }}", 3),
        ("{{ data.list }}", [1, {"a": 2}]),
        ("{{ vars.image }}:{{ data.n }}", "ros:3"),
        ("{{ data.list[0] + vars.count }}", 4),
        ("{{ data.map.key }}", "x"),
        ("{{ data.missing | default('d') }}", "d"),
        ("{{ '{{' }} {{ data.n }}", "{{ 3"),
        ("{{ data.braces }}", "{{ vars.image }}"),
    ],
)
def test_data_is_filled_in_when_a_job_runs(loaded: Loader, text: str, value: Any) -> None:
    """Before that it is a hole, which other templates of the same text wait for."""
    quoted = text.replace("'", "''")
    data = {"n": 3, "list": [1, {"a": 2}], "map": {"key": "x"}, "braces": "{{ vars.image }}"}
    assert filled(loaded, f"{{a: '{quoted}'}}", data) == {"a": value}
    assert filled(loaded, f"{{a: '{quoted}'}}", {}, final=False) == {"a": text}


def test_a_text_is_filled_once(loaded: Loader) -> None:
    """What was meant as braces when the file was read stays that when a job runs."""
    text = """{a: "{{ '{{ vars.image }}' }}"}"""
    assert filled(loaded, text, {}) == {"a": "{{ vars.image }}"}


def test_a_var_may_wait_for_data(loaded: Loader) -> None:
    """What refers to such a var waits with it."""
    rigelfile = loaded(
        "vars: {a: 'x{{ data.n }}', b: '{{ vars.a }}y', c: [1, '{{ vars.b }}']}\n"
        + JOB % "{one: '{{ vars.b }}', two: '{{ vars.c }}', \"{{ data.n }}\": k}"
    )
    assert fill(rigelfile, {})[0].has_hole()
    node, _ = fill(rigelfile, {"n": 1}, final=True)
    assert strip_places(node) == {"one": "x1y", "two": [1, "x1y"], "1": "k"}


def test_unknown_data_is_told_when_the_job_runs(loaded: Loader) -> None:
    """The nearest name that was stored is named."""
    assert filled(loaded, "{a: '{{ data.imge }}'}", {"image": 1}) == [
        "no earlier job has stored data.imge, did you mean data.image?"
    ]
    assert filled(loaded, "{a: '{{ data.x }}'}", {}) == [
        "no earlier job has stored data.x, earlier jobs stored nothing yet"
    ]


def test_data_that_is_none(loaded: Loader) -> None:
    """What a job stored may be no data, or have nothing of that name in it."""
    assert filled(loaded, "{a: '{{ data.o }}'}", {"o": object()}) == ["data.o: object is not data"]
    assert filled(loaded, "{a: '{{ data.n.x }}'}", {"n": 1}) == [
        "no earlier job has stored data.n.x, earlier jobs stored data.n"
    ]


def test_an_expression_waits_for_what_its_vars_wait_for(loaded: Loader) -> None:
    """A filter is applied when the value is there."""
    rigelfile = loaded(
        "vars: {a: 'x{{ data.n }}'}\n"
        + JOB % "{one: '{{ vars.a | upper }}', two: '{{ data.n + 1 }}'}"
    )
    assert fill(rigelfile, {})[0].has_hole()
    assert strip_places(fill(rigelfile, {"n": 1})[0]) == {"one": "X1", "two": 2}


@pytest.mark.programs
def test_jinja2_is_imported_only_for_expressions() -> None:
    """A file of plain names pays nothing for expressions."""
    program = "import sys, rigel_k8s.rigelfile; sys.exit('jinja2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

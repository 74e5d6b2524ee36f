"""rcl of PyPI answers what ros_names.py and ros_parameters.py in tests/support say."""

from __future__ import annotations

import json
import subprocess
from typing import Any

import pytest

from tests.support.ros_names import ARGUMENTS, NODES, RCL
from tests.support.ros_parameters import MATCHING, VALUES, WRONG

from .conftest import environment

pytestmark = pytest.mark.cluster

ASK = """
import json, rclpy, sys
def accepts(rule):
    context = rclpy.Context()
    try:
        rclpy.init(args=["--ros-args", "-r", rule], context=context)
    except Exception:
        return False
    try:
        rclpy.create_node("n", context=context).destroy_node()
        return True
    except Exception:
        return False
    finally:
        rclpy.shutdown(context=context)
print(json.dumps([accepts(rule) for rule in json.load(sys.stdin)]))
"""


def test_rcl_accepts_what_the_table_says() -> None:
    rules = [f"{name}:=/x" for name, *_ in RCL] + [f"x:={name}" for name, *_ in RCL]
    rules += [f"__node:={name}" for name, _ in NODES]
    python = str(environment("jazzy") / "bin" / "python")
    asked = subprocess.run(
        [python, "-c", ASK], input=json.dumps(rules), capture_output=True, text=True, check=True
    )
    expected = [one for _, one, _ in RCL] + [one for _, _, one in RCL] + [one for _, one in NODES]
    answers = dict(zip(rules, json.loads(asked.stdout), strict=True))
    assert answers == dict(zip(rules, expected, strict=True))


START = """
import json, rclpy, sys
def starts(words):
    context = rclpy.Context()
    try:
        rclpy.init(args=["--ros-args", *words], context=context)
    except Exception:
        return False
    rclpy.shutdown(context=context)
    return True
print(json.dumps([starts(words) for words in json.load(sys.stdin)]))
"""


def test_rcl_starts_with_the_arguments_that_the_table_says() -> None:
    python = str(environment("jazzy") / "bin" / "python")
    given = json.dumps([words for words, _ in ARGUMENTS])
    asked = subprocess.run(
        [python, "-c", START], input=given, capture_output=True, text=True, check=True
    )
    expected = [(words, starts) for words, starts in ARGUMENTS]
    found = zip((words for words, _ in ARGUMENTS), json.loads(asked.stdout), strict=True)
    assert list(found) == expected


READ = """
import json, rclpy, sys, tempfile
def read(text, namespace):
    context = rclpy.Context()
    file = tempfile.NamedTemporaryFile("w", suffix=".yaml")
    file.write(text + "\\n")
    file.flush()
    args = ["-r", "__node:=mapper", "-r", f"__ns:={namespace}", "--params-file", file.name]
    try:
        rclpy.init(args=["--ros-args", *args], context=context)
    except Exception:
        return None
    try:
        node = rclpy.create_node(
            "n", context=context, automatically_declare_parameters_from_overrides=True
        )
        found = node.get_parameters_by_prefix("")
        node.destroy_node()
        return {key: value.value for key, value in found.items() if key in ("a", "x")}
    except Exception:
        return None
    finally:
        rclpy.shutdown(context=context)
print(json.dumps([read(*one) for one in json.load(sys.stdin)], default=list))
"""


def read(files: list[tuple[str, str]]) -> list[Any]:
    """Return what rcl reads of files for /mapper in a namespace."""
    python = str(environment("jazzy") / "bin" / "python")
    asked = subprocess.run(
        [python, "-c", READ], input=json.dumps(files), capture_output=True, text=True, check=True
    )
    return list(json.loads(asked.stdout))


def test_rcl_matches_the_keys_that_the_table_says() -> None:
    for namespace, place in (("/", 1), ("/r1", 2)):
        found = read([(text, namespace) for text, *_ in MATCHING])
        for case, answer in zip(MATCHING, found, strict=True):
            assert answer == ({"a": 1} if case[place] else {}), case


def test_rcl_ends_with_what_the_table_says() -> None:
    assert read([(text, "/") for text in WRONG]) == [None] * len(WRONG)


def test_rcl_reads_the_values_that_the_table_says() -> None:
    files = [(f"/**:\n  ros__parameters:\n    x: {value}", "/") for value, _ in VALUES]
    expected = [None if value is ... else {"x": value} for _, value in VALUES]
    assert read(files) == expected

"""rcl of PyPI answers what tests/support/ros_names.py says of names."""

from __future__ import annotations

import json
import subprocess

import pytest

from tests.support.ros_names import NODES, RCL

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

"""The level of log lines, as ROS 1, ROS 2 and their neighbours write them."""

from __future__ import annotations

import pytest

from rigel_k8s.commands.logs.lines import LevelReader, at_least, level_of

LINES = {
    # rospy, with and without simulated time, and roscpp, which colours and aligns
    "[INFO] [1763728000.123456]: talker version 1": "info",
    "[DEBUG] [1763728000.123456, 12.500000]: tick": "debug",
    "[WARN] [WallTime: 1763728000.1] [0.5] late": "warn",
    "\x1b[33m[ WARN] [1763728000.123456789]: queue full\x1b[0m": "warn",
    "\x1b[0m[ INFO] [1763728000.123456789]: hello\x1b[0m": "info",
    "\x1b[31m[FATAL] [1763728000.123456789]: no hardware\x1b[0m": "fatal",
    # rclpy and rclcpp, and both launches
    "[INFO] [1763728000.123456789] [talker]: hello": "info",
    "[ERROR] [1763728000.123456789] [lab.arm]: lost": "error",
    "[talker-1] [ERROR] [1763728000.123456789] [talker]: lost": "error",
    "[ERROR] [talker-1]: process has died [pid 7, exit code 1, cmd 'x'].": "error",
    "[rosmaster.main][INFO] 2026-11-21 12:00:00,000: up": "info",
    "\x1b[0m[talker-1] \x1b[33m[WARN] [1763728000.1] [talker]: late\x1b[0m": "warn",
    # Python's logging, roslaunch, Rust's tracing, Fast DDS
    "WARNING:root:careful": "warn",
    "ERROR: cannot launch node of type [x/y]": "error",
    "CRITICAL:root:down": "fatal",
    "2026-11-21T12:00:00.000001Z  WARN ThreadId(02) zenoh: late": "warn",
    "2026-11-21 12:00:00.123 [RTPS_TRANSPORT_SHM Error] Failed to lock -> Function x": "error",
    "Traceback (most recent call last):": "error",
    # what says no level of itself
    "hello world none 17": "",
    "started roslaunch server http://10.0.0.1:33333/": "",
    "[talker-1] process has finished cleanly": "",
    "the error: nothing": "",
    "information [ERROR] is not at the beginning": "",
    "": "",
}


@pytest.mark.parametrize(("line", "level"), LINES.items())
def test_a_line_says_its_level(line: str, level: str) -> None:
    """ROS 1's and ROS 2's formats, coloured or not, alone or under a launch."""
    assert level_of(line) == level


def levels(text: str) -> list[str]:
    reader = LevelReader()
    return [reader.level(line) for line in text.splitlines()]


def test_a_traceback_belongs_to_its_line() -> None:
    """Up to its exception; what comes after it has a level of its own, or none."""
    text = """[INFO] [1.0]: begin
[ERROR] [1.1]: bad callback: <function heard at 0x7f>
Traceback (most recent call last):
  File "/opt/ros/topics.py", line 750, in _invoke_callback
    cb(msg)

ValueError: boom
done
[INFO] [1.2]: on
  indented, so it goes on"""
    assert levels(text) == ["info", *["error"] * 6, "", "info", "info"]


def test_a_logged_traceback_keeps_the_level_it_was_logged_with() -> None:
    """Its head stands on the line that says the level."""
    text = """[WARN] [1.1]: Traceback (most recent call last):
  File "a.py", line 1
KeyError: 'x'
plain"""
    assert levels(text) == ["warn", "warn", "warn", ""]


def test_an_exception_of_any_name_ends_its_traceback() -> None:
    """After its head everything belongs to it, up to the first line that is not indented."""
    text = """[WARN] [1.1]: failed: Traceback (most recent call last):
  File "a.py", line 1
lab.Boom: no such arm
plain"""
    assert levels(text) == ["warn", "warn", "warn", ""]


def test_chained_exceptions_are_one_error() -> None:
    """With the sentence and the blank lines between them."""
    text = """[INFO] [1.0]: begin
Traceback (most recent call last):
  File "a.py", line 1
KeyError: 'x'

During handling of the above exception, another exception occurred:

Traceback (most recent call last):
  File "a.py", line 3
RuntimeError: gone
plain"""
    assert levels(text) == ["info", *["error"] * 9, ""]


def test_a_level_means_that_and_above() -> None:
    """As people ask for them."""
    assert at_least("warn") == {"warn", "error", "fatal"}
    assert at_least("debug") == {"debug", "info", "warn", "error", "fatal"}
    assert at_least("fatal") == {"fatal"}
